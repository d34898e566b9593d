//! The surface of a model as a triangle mesh with its uncertainty.

use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::ply::{PlyWriter, SURFACE};
use super::surface_net::SurfaceNet;
use octobayes::field::{Radiance, RadianceField};
use octobayes::geometry::Aabb;
use octobayes::monitor::{Monitor, check};
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

/// How a surface is found.
#[derive(Debug, Clone, Copy)]
pub struct MeshSettings {
    /// Cells along the longest edge of the model's box.
    pub resolution: u32,
    /// σ on the surface, 1 / scene unit; `None` for what absorbs half of the light along the edge of a cell.
    pub density: Option<f64>,
}

impl Default for MeshSettings {
    fn default() -> Self {
        Self { resolution: 192, density: None }
    }
}

/// A lattice of cubes that covers a box, with one cube of empty space around.
struct Cubes {
    bounds: Aabb,
    /// Edge of a cube, scene units.
    edge: f64,
    /// Points along x, y and z.
    points: [usize; 3],
}

impl Cubes {
    fn new(bounds: Aabb, resolution: u32) -> Self {
        let edge = bounds.longest_edge() / f64::from(resolution);
        // Cells, one point more than those, and one more on either side.
        let points = bounds.size().to_array().map(|side| (side / edge - 1e-6).ceil() as usize + 3);
        Self { bounds, edge, points }
    }

    /// Scene position of array coordinates.
    fn position(&self, at: DVec3) -> DVec3 {
        self.bounds.min() + self.edge * (at - 1.0)
    }

    /// ½ minus the light that a cube absorbs along its edge, relative to that of `density`: negative inside. Densities
    /// grow exponentially towards the inside of some models; this does not, so that crossings are found between points.
    fn outside(&self, field: &dyn RadianceField, density: f64, monitor: &dyn Monitor) -> Result<Vec<f32>> {
        let [nx, ny, nz] = self.points;
        let mut out = vec![0.5_f32; nx * ny * nz];
        monitor.begin("layers", nz as u64);
        out.par_chunks_mut(nx * ny).enumerate().try_for_each(|(z, layer)| {
            check(monitor)?;
            let at = |i: usize| self.position(DVec3::new((i % nx) as f64, (i / nx) as f64, z as f64)).as_vec3();
            let inside: Vec<usize> = (0..nx * ny).filter(|&i| self.bounds.contains(at(i))).collect();
            let positions: Vec<Vec3> = inside.iter().map(|&i| at(i)).collect();
            let mut densities = vec![0.0; positions.len()];
            field.densities(&positions, &mut densities);
            for (i, sigma) in inside.into_iter().zip(densities) {
                layer[i] = ((-std::f64::consts::LN_2 * f64::from(sigma) / density).exp() - 0.5) as f32;
            }
            monitor.advance(1);
            Ok(())
        })?;
        monitor.end();
        // The surface is closed: beside the box there is nothing.
        for (i, value) in out.iter_mut().enumerate() {
            let [x, y, z] = [i % nx, i / nx % ny, i / (nx * ny)];
            if x == 0 || y == 0 || z == 0 || x == nx - 1 || y == ny - 1 || z == nz - 1 {
                *value = 0.5;
            }
        }
        Ok(out)
    }
}

/// Writes the surface of `model` where its density is that of the settings, by surface nets, with the model's colour
/// seen from outside, normals, and U of `field`. Returns the number of vertices and triangles.
///
/// # Errors
/// If the file cannot be written, if nothing is as dense, or [`Error::Interrupted`].
pub fn write_mesh(
    path: &Path,
    model: &dyn RadianceField,
    field: &UncertaintyField,
    settings: MeshSettings,
    monitor: &dyn Monitor,
) -> Result<[usize; 2]> {
    let cubes = Cubes::new(model.bounds(), settings.resolution);
    let density = settings.density.unwrap_or(std::f64::consts::LN_2 / cubes.edge);
    let outside = cubes.outside(model, density, monitor)?;
    let net = SurfaceNet::new(&outside, cubes.points);
    if net.positions.is_empty() {
        let least = outside.iter().copied().fold(0.5, f32::min);
        let densest = -(f64::from(least) + 0.5).ln() / std::f64::consts::LN_2 * density;
        let expected = format!("a density below the model's largest on this lattice, {densest:.4}");
        return Err(Error::setting("--density", expected, format!("{density:.4} per scene unit")));
    }
    let placed = |at: &Vec3| cubes.bounds.clamp(cubes.position(at.as_dvec3()).as_vec3());
    let positions: Vec<Vec3> = net.positions.iter().map(placed).collect();
    let normals: Vec<Vec3> = net.gradients.iter().map(|gradient| gradient.normalize_or(Vec3::Z)).collect();
    let mut radiance = vec![Radiance::default(); positions.len()];
    let chunks = positions.par_chunks(1024).zip(normals.par_chunks(1024)).zip(radiance.par_chunks_mut(1024));
    chunks.for_each(|((positions, normals), out)| {
        let directions: Vec<Vec3> = normals.iter().map(|n| -*n).collect();
        model.evaluate(positions, &directions, out);
    });
    let found = field.query_all(&positions);

    let counts = [positions.len(), net.triangles.len()];
    let elements = [("vertex", counts[0], &SURFACE[..]), ("face", counts[1], &[("list uchar int", "vertex_indices")])];
    let comments = [format!("density {density:.6} per scene unit; {}", field.record().scale.quantity())];
    let mut ply = PlyWriter::create(path, &comments, &elements)?;
    for (i, found) in found.iter().enumerate() {
        ply.surface(positions[i], normals[i], radiance[i].color, found)?;
    }
    for triangle in net.triangles {
        ply.put(&[3])?;
        triangle.iter().try_for_each(|&v| ply.put(&(v as i32).to_le_bytes()))?;
    }
    ply.finish()?;
    Ok(counts)
}
