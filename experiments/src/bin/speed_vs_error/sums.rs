//! How few bytes the sums of a vertex could be kept in, and what each covariance would lose.

use octobayes::Result;
use octobayes::estimate::{GridKind, Outcome};
use octobayes::posterior::{Covariance, FactoredSums, VertexSums};
use octobayes::render::GradientMethod;
use rayon::prelude::*;

use super::measure::grid;
use common::scenes::Scene;
use common::settings::{describe, seeds};
use common::table::{Table, whole};
use common::work::Work;

/// Ways to keep a vertex's Cholesky factor L: what it is, bits of each entry if these are fewer than those of f32, and
/// bytes of a vertex with four for its ray count. These have room for the order of its pivots, which the signs of f32
/// hold.
const WAYS: [(&str, Option<u32>, usize); 4] = [
    ("factor in f32, as in files", None, 28),
    ("factor in 16 bits an entry", Some(16), 16),
    ("factor in 12 bits an entry", Some(12), 13),
    ("factor in 8 bits an entry", Some(8), 10),
];

/// Range of log2 of the diagonals, which are coded by their logarithms.
struct Range {
    least: f64,
    most: f64,
}

impl Range {
    fn of(factors: &[FactoredSums]) -> Self {
        let diagonals = factors.iter().filter_map(FactoredSums::factor).flat_map(|(_, l)| [l[0], l[2], l[5]]);
        let logs = diagonals.filter(|l| *l > 0.0).map(|l| f64::from(l).log2());
        let (least, most) = logs.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), l| (a.min(l), b.max(l)));
        Self { least, most }
    }

    /// A diagonal entry as `bits` bits would have it; code 0 is zero.
    fn coded(&self, l: f64, bits: u32) -> f64 {
        if l <= 0.0 {
            return 0.0;
        }
        let steps = f64::from(2_u32.pow(bits) - 2);
        let step = (self.most - self.least) / steps;
        (self.least + ((l.log2() - self.least) / step).round() * step).exp2()
    }
}

/// An entry below the diagonal as a fraction of the diagonal above it, -1 to 1, in `bits` bits.
fn fraction(l: f64, diagonal: f64, bits: u32) -> f64 {
    let most = f64::from(2_u32.pow(bits - 1) - 1);
    if diagonal > 0.0 { (l / diagonal * most).round() / most } else { 0.0 }
}

/// The sums of a factor in so many bits an entry.
fn rounded(factor: &FactoredSums, range: &Range, bits: u32) -> VertexSums {
    let (order, entries) = factor.factor().expect("of a run");
    let [l00, l10, l11, l20, l21, l22] = entries.map(f64::from);
    let [d0, d1, d2] = [l00, l11, l22].map(|l| range.coded(l, bits));
    let below = |l: f64, from: f64, to: f64| to * fraction(l, from, bits);
    let rows = [[d0, 0.0, 0.0], [below(l10, l00, d0), d1, 0.0], [below(l20, l00, d0), below(l21, l11, d1), d2]];
    let mut information = [0.0; 6];
    for i in 0..3 {
        for k in 0..=i {
            let (a, b) = (order[i].min(order[k]), order[i].max(order[k]));
            information[[0, 3, 5][a] + b - a] = (0..3).map(|c| rows[i][c] * rows[k][c]).sum();
        }
    }
    VertexSums::new(information, factor.sums().rays)
}

/// |Δ log10 σ| of each covariance over the vertices that rays touched: mean, maximum.
pub fn sums(work: &Work, lego: &Scene) -> Result<(String, String)> {
    let rays = lego.settings.gradient(GradientMethod::Analytic);
    let octree = grid(GridKind::Octree, 8).keep_sums(true);
    type Errors = Vec<[[f64; 2]; 3]>;
    let (vertices, errors): (u64, Errors) = work.row("sums", || {
        let Outcome { field, .. } = lego.estimation(rays, octree).run()?;
        let sums: Vec<VertexSums> = field.sums().expect("kept").iter().copied().filter(|s| s.rays > 0).collect();
        let (lambda, drawn) = (field.record().lambda, field.record().rays);
        let factors: Vec<FactoredSums> = sums.iter().map(Into::into).collect();
        let range = Range::of(&factors);
        let error = |bits: Option<u32>, covariance: Covariance| {
            let each = sums.par_iter().zip(&factors).map(|(sums, factor)| {
                let kept = bits.map_or_else(|| factor.sums(), |bits| rounded(factor, &range, bits));
                let [a, b] = [&kept, sums].map(|sums| covariance.deviation(sums, drawn, lambda));
                (a / b).log10().abs()
            });
            let all: Vec<f64> = each.collect();
            [all.iter().sum::<f64>() / all.len() as f64, all.iter().copied().fold(0.0, f64::max)]
        };
        let of = |&(_, bits, _): &(_, Option<u32>, _)| Covariance::ALL.map(|covariance| error(bits, covariance));
        Ok((sums.len() as u64, WAYS.iter().map(of).collect()))
    })?;
    let head = ["kept", "bytes of a vertex"].map(String::from);
    let columns = Covariance::ALL.iter().flat_map(|c| [format!("{}: mean", c.name()), "max".into()]);
    let head: Vec<String> = head.into_iter().chain(columns).collect();
    let mut table = Table::new(&head.iter().map(String::as_str).collect::<Vec<_>>());
    for ((name, _, bytes), errors) in WAYS.iter().zip(errors) {
        let cells = errors.into_iter().flatten().map(|e| format!("{e:.0e}"));
        table.row(&[(*name).to_string(), bytes.to_string()].into_iter().chain(cells).collect::<Vec<_>>());
    }
    let words = format!(
        "{}. {} {} |Δ log10 σ| of the {} vertices that rays touched, against the exact sums in f64 (52 bytes).",
        lego.name,
        describe(&rays, &octree, &["covariance"]),
        seeds(&[0]),
        whole(vertices as f64)
    );
    Ok((words, table.text().into()))
}
