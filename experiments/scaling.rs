//! Question: how do vertices, bytes and time grow with the level, in a scene that no dense grid can hold at its finest?
//!
//! The closed-form city (seed 0, 800 cameras of 400 × 300 along a drive), occupancy 512: levels 8 to 12, 1,024,000 rays, as many vertices as
//! it takes; and levels 12 and 13, 4,096,000 rays, in at most 4 GiB. Every row is a process of its own, so that its peak memory is its own; point queries are at a
//! million random points of the surfaces that the rays saw. Prints the table of `experiments/scaling.md`, and writes its plot.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, Outcome, RaySettings};
use octobayes::field::{ClosedForm, Intrinsics, RadianceField};
use octobayes::geometry::{Domain, Lattice};
use octobayes::internal::memory;
use octobayes::internal::{Curve, write_plot};

const QUERIES: usize = 1_000_000;

fn main() -> Result<()> {
    let arguments: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    if let [level, rays, memory] = arguments[..] {
        return row(level as u8, rays, Some(memory).filter(|&bytes| bytes > 0));
    }
    let rows = (8..=12).map(|level| (level, 1_024_000, 0));
    let rows = rows.chain([12, 13].map(|level| (level, 4_096_000, 4 << 30)));
    println!(
        "| level | rays | budget | vertices | bytes of field for queries | structure, B / vertex | dense f32 grid, bytes | dense : field | sums kept, bytes | peak of the process, MB | time, s | query, ns |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut curves: [Vec<(f64, f64)>; 4] = Default::default();
    for (level, rays, memory) in rows {
        let program =
            std::env::current_exe().map_err(octobayes::Error::io(Path::new("this program"), "cannot find"))?;
        let output = Command::new(program).args([level, rays, memory].map(|v: u64| v.to_string())).output();
        let output = output.map_err(octobayes::Error::io(Path::new("this program"), "cannot run"))?;
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let line = String::from_utf8_lossy(&output.stdout).trim().to_string();
        println!("{line}");
        if memory == 0 {
            let cells: Vec<f64> = line.split('|').filter_map(|cell| cell.trim().parse().ok()).collect();
            // Columns as printed by `row`, without the budget, which is no number.
            let [vertices, bytes, dense, time] = [2, 3, 5, 9].map(|i| cells[i].log10());
            curves.iter_mut().zip([vertices, bytes, dense, time]).for_each(|(c, y)| c.push((level as f64, y)));
        }
    }
    let names = ["vertices", "bytes for queries", "bytes of the dense f32 grid", "seconds"];
    let curves: Vec<Curve> = names
        .iter()
        .zip(curves)
        .map(|(name, points)| Curve { name: (*name).into(), points, reference: false })
        .collect();
    write_plot(Path::new("experiments/scaling.svg"), "city: growth with the level", ["level", "log10"], &curves)
}

fn row(level: u8, rays: u64, memory: Option<u64>) -> Result<()> {
    let city = ClosedForm::named("city")?;
    let cameras = city.cameras(&Intrinsics::default())?.unwrap_or_default();
    let grid = GridSettings::default().level(level).memory(memory).surface_points(QUERIES);
    let settings = RaySettings::default().rays(rays).occupancy(512);
    let start = Instant::now();
    let Outcome { field, .. } = Estimation::new(&city, &cameras).rays(settings).grid(grid).run()?;
    let time = start.elapsed().as_secs_f64();
    let peak = memory::peak().unwrap_or(0) as f64 / 1e6;
    let kept = field.sums().map_or(0, size_of_val);
    let points: Vec<Vec3> = field.surface().iter().map(|&x| Vec3::from_array(x)).collect();
    // In an order that no cache likes.
    let n = points.len();
    let start = Instant::now();
    let sum: f64 = (0..n).map(|i| field.query(points[i * 7_368_787 % n]).uncertainty).sum();
    let query = start.elapsed().as_secs_f64() * 1e9 / n as f64;
    assert!(sum.is_finite(), "queries have answers");
    let s = field.summary();
    let dense = 4 * Lattice::of_domain(Domain::Box(city.bounds()), level)?.dense_vertices();
    println!(
        "| {level} | {rays} | {} | {} | {} | {:.2} | {dense} | {:.0} | {kept} | {peak:.0} | {time:.1} | {query:.0} |",
        memory.map_or("none".into(), |m| format!("{} GiB", m >> 30)),
        s.vertices,
        s.query_bytes,
        s.structure_bytes as f64 / s.vertices as f64,
        dense as f64 / s.query_bytes as f64,
    );
    Ok(())
}
