//! Scores of splats: larger means less certain.

use glam::{DMat3, DQuat, DVec3, Vec3};
use octobayes::Result;
use octobayes::estimate::{Estimation, GridSettings, RaySettings};
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::monitor::Silent;
use octobayes::octree::trilinear;
use octobayes::posterior::{Covariance, DataScale, Scale, VertexSums};
use octobayes::rays::Pixels;
use octobayes::uncertainty::UncertaintyField;
use octobayes_clean::Evidence;
use octobayes_splats::Splats;
use rayon::prelude::*;

use common::isolation::isolation;

use crate::blocks::{Blocks, Sums, trace};

/// Level of the field.
pub const LEVEL: u8 = 7;
/// Names of the scores of [`all`], in its order.
pub const NAMES: [&str; 14] = [
    "U along the normal",
    "U, block",
    "U along the normal × largest scale",
    "every splat by itself, normal",
    "every splat by itself, block",
    "PUP: −log det",
    "FisherRF, colours",
    "weight",
    "views",
    "front share",
    "1 − opacity",
    "log volume",
    "largest scale",
    "distance of 8 neighbours",
];

/// The scores of all splats by every pixel of their cameras, `[NAMES][n]`. `noise`: error of the model's colours.
pub fn all(splats: &Splats, cameras: &[Camera], bounds: Aabb, noise: f64) -> Result<Vec<Vec<f64>>> {
    let domain = Domain::Box(bounds);
    let scale = DataScale::from_cameras(cameras, noise, &domain)?;
    let mut sums = Sums::new(splats);
    let grid = GridSettings::default().level(LEVEL).covariance(Covariance::Block).keep_sums(true);
    let run = Estimation::new(splats, cameras).domain(domain).grid(grid.scale(Scale::Data(scale)));
    let run = run.rays(RaySettings::default().pixels(Pixels::Every)).tap(|batches| {
        sums.add(batches);
        Ok(())
    });
    let field = run.run()?.field;
    let blocks = sums.blocks(&scale, scale.pixels);
    let (seen, _) = Evidence::measure(splats, cameras, 0.5, scale.pixels, &Silent)?;
    let posterior = |i: usize, direction: DVec3| along(&field, splats.mean(i), direction);
    let each = |value: &(dyn Fn(usize) -> f64 + Sync)| (0..splats.len()).into_par_iter().map(value).collect::<Vec<_>>();
    let normal = each(&|i| posterior(i, normal(splats, i)).sqrt());
    let largest = each(&|i| f64::from(splats.scale(i).max_element()));
    Ok(vec![
        normal.clone(),
        each(&|i| DVec3::AXES.map(|axis| posterior(i, axis)).iter().sum::<f64>().sqrt()),
        each(&|i| normal[i] * largest[i]),
        each(&|i| normal_of(&blocks, splats, i)),
        each(&|i| trace(&blocks.covariance[i]).sqrt()),
        each(&|i| -blocks.precision[i].determinant().ln()),
        each(&|i| -blocks.fisher[i]),
        each(&|i| -seen.weight[i]),
        each(&|i| -f64::from(seen.views[i])),
        each(&|i| seen.front_share(i)),
        each(&|i| 1.0 - f64::from(splats.opacity(i))),
        each(&|i| f64::from(splats.log_scales()[i].element_sum())),
        largest.clone(),
        isolation(splats),
    ])
}

/// The thin axis of a splat.
fn normal(splats: &Splats, i: usize) -> DVec3 {
    let q = splats.rotation(i);
    let axes = DMat3::from_quat(DQuat::from_array(q.to_array().map(f64::from)).normalize());
    axes.col(splats.scale(i).min_position())
}

/// Variance of the displacement at a scene point along a unit vector n under the field's posterior, in which vertices are
/// independent: Σ_v φ_v² nᵀ C_v n, scene units².
fn along(field: &UncertaintyField, x: Vec3, n: DVec3) -> f64 {
    let (lattice, record) = (field.lattice(), field.record());
    let Some(u) = lattice.coordinates(x) else { return field.prior().powi(2) / 3.0 };
    let (cell, offset) = lattice.cell(u);
    let scale = record.scale.factor(record.covariance).powi(2);
    let of_corner = |(c, weight): (u32, f64)| {
        let vertex = field.vertex_at(std::array::from_fn(|axis| cell[axis] + (c >> axis & 1)));
        let sums = vertex.map_or_else(VertexSums::default, |v| field.sums().expect("kept sums")[v]);
        let [xx, xy, xz, yy, yz, zz] = record.covariance.matrix(&sums, record.rays, record.lambda);
        let matrix = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        weight * weight * scale * n.dot(matrix * n)
    };
    (0..).zip(trilinear(offset)).map(of_corner).sum()
}

fn normal_of(blocks: &Blocks, splats: &Splats, i: usize) -> f64 {
    let n = normal(splats, i);
    n.dot(blocks.covariance[i] * n).sqrt()
}
