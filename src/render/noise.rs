//! The noise of a field, and the error that it causes in finite differences.
//!
//! A field in f32, or one that rounds its weights or its output, is a smooth function plus noise of
//! standard deviation ε. A central difference over ±h divides that noise by h and truncates the
//! function. The error per derivative is
//!
//! ```text
//! E(h)² = ε² / 2h² + (μ h² / 6)²        smallest at h* = (3 ε / μ)^⅓
//! ```
//!
//! with the third derivative μ. ε comes from difference tables ([`noise_level`]: Moré, Wild, *Estimating
//! Computational Noise*, 2011; the optimum is that of their *Estimating Derivatives of Noisy Simulations*,
//! 2012). μ is measured for each h as the third difference over [−h, h]. At a kink there is no third derivative,
//! but this is about the error of a difference across it. A field that differentiates itself is compared with
//! its own ∇σ instead. E is then known for every step ([`DifferenceErrors`]). The best step is where E is
//! smallest, up to [`LONGEST_STEP`].
//!
//! All errors are means of absolute values over points, relative to the mean of |∂σ|. A mean of squares could be
//! decided by a single point beside a kink.

use glam::Vec3;
use rayon::prelude::*;

use super::Differences;
use crate::field::RadianceField;
use crate::geometry::Aabb;

/// Number of values in a difference table.
pub const TABLE: usize = 9;
/// Steps per decade at which errors are measured, and their range as powers of ten of a lattice edge, in such steps.
const PER_DECADE: i32 = 2;
const RANGE: std::ops::RangeInclusive<i32> = -5 * PER_DECADE..=PER_DECADE;
/// Longest step that is still a derivative at a point, in edges of the finest lattice.
///
/// A central difference is the mean of the derivative over [x − h, x + h]. The vertices around x share it by
/// weights that change by 1 / edge, so a share of up to h / 2 edges goes to the wrong vertex. At 1/8 that is 6 % of
/// it, or 0.03 in log10 U, however smooth the field is. Longer steps are never proposed.
pub const LONGEST_STEP: f64 = 0.125;
/// Spacings of tables, as exponents of two in units in the last place of positions. The
/// narrowest that shows noise is used.
const SPACINGS: [i32; 6] = [2, 4, 6, 8, 10, 12];
/// Number of lines that are evaluated together.
const BATCH: usize = 32;

/// Standard deviation of the noise in values at equal, small distances, by the ECnoise algorithm.
///
/// `None` if the values do not look like noise on a smooth function: they change too much, or are too smooth, or
/// lie on plateaus because the distance is too small.
///
/// The k-th differences of a smooth function fall quickly with k; those of noise grow as √(2k choose k). So
/// σ_k = rms(Δᵏ) / √(2k choose k) settles where only noise is left: where three of them in a row agree within a
/// factor of 4 and Δᵏ changes sign.
#[must_use]
pub fn noise_level(values: &[f64; TABLE]) -> Option<f64> {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
    // The function itself must not change much (Moré and Wild require a tenth).
    if high - low > 0.1 * high.abs().max(low.abs()) {
        return None;
    }
    let plateaus = values.windows(2).filter(|pair| pair[0] == pair[1]).count();
    if plateaus >= TABLE / 2 {
        return None;
    }
    let mut differences = values.to_vec();
    let mut gamma = 1.0;
    let (mut levels, mut turns) = (Vec::new(), Vec::new());
    for k in 1..TABLE - 1 {
        differences = differences.windows(2).map(|pair| pair[1] - pair[0]).collect();
        // γ_k = (k!)² / (2k)!
        gamma *= 0.5 * k as f64 / (2 * k - 1) as f64;
        let mean_square = differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64;
        levels.push((gamma * mean_square).sqrt());
        turns.push(differences.iter().any(|d| *d > 0.0) && differences.iter().any(|d| *d < 0.0));
    }
    (0..levels.len() - 2).find_map(|k| {
        let (low, high) = levels[k..k + 3].iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &v| (l.min(v), h.max(v)));
        (turns[k] && low > 0.0 && high <= 4.0 * low).then_some(levels[k])
    })
}

/// Error of central differences of a field's density at one step, relative to ∂σ.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct DifferenceError {
    /// Distance to both sides, in lattice edges.
    pub step: f64,
    /// Error from noise.
    pub noise: f64,
    /// Error from truncation.
    pub truncation: f64,
    /// Standard error of the truncation error, from the choice of points.
    pub doubt: f64,
}

impl DifferenceError {
    /// Noise and truncation together.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.noise.hypot(self.truncation)
    }

    /// Approximate change of log10 U: information is quadratic in derivatives, and U is its inverse square root.
    #[must_use]
    pub fn in_log10(&self) -> f64 {
        self.total() * std::f64::consts::LOG10_E
    }

    /// Lower bound of the total error, with a margin of two standard errors.
    fn at_least(&self) -> f64 {
        self.noise.hypot((self.truncation - 2.0 * self.doubt).max(0.0))
    }
}

/// Errors of central differences at all steps.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct DifferenceErrors {
    /// Number of points at which the density changes.
    pub points: usize,
    /// ε / σ, root mean square over the points.
    pub noise: f64,
    /// Third derivative relative to the first, 1 / lattice edge², at the smallest step at which it stands out from
    /// the noise; 0 if there is none.
    pub curvature: f64,
    /// Errors by increasing step, for steps that fit into the box around most points; at least one.
    pub steps: Vec<DifferenceError>,
}

/// A step is misplaced if it costs at least this factor over the best one.
const FACTOR: f64 = 3.0;

impl DifferenceErrors {
    /// Steps to measure, in lattice edges, increasing: two per decade from `shortest` to ten edges, and `own`.
    #[must_use]
    pub fn steps(shortest: f64, own: f64) -> Vec<f64> {
        let regular = RANGE.map(|k| 10_f64.powf(f64::from(k) / f64::from(PER_DECADE)));
        let mut steps: Vec<f64> = regular.filter(|step| *step >= shortest).chain([own]).collect();
        steps.sort_by(f64::total_cmp);
        steps.dedup();
        steps
    }

    /// Measures the density of `field` near `points`, along one axis at each in turn, at increasing `steps`.
    ///
    /// `lattice` has a step of one lattice edge. `None` if the density changes nowhere near the points.
    #[must_use]
    pub fn measure(field: &dyn RadianceField, points: &[Vec3], lattice: &Differences, steps: &[f64]) -> Option<Self> {
        let bounds = field.bounds();
        let mut lines: Vec<Line> =
            points.iter().enumerate().filter_map(|(i, &x)| Line::through(x, i % 3, lattice, &bounds)).collect();
        let noises = noises(field, &mut lines);
        let own = own_slopes(field, &lines);
        let mut stencils: Vec<Vec<Option<LineStencil>>> =
            steps.iter().map(|&step| stencils(field, &lines, step)).collect();
        let slopes: Vec<f64> = match &own {
            Some(own) => own.clone(),
            None => (0..lines.len())
                .map(|p| {
                    let candidates = stencils.iter().filter_map(|stencils| stencils[p]);
                    let known_best = candidates.min_by(|a, b| a.doubt(noises[p]).total_cmp(&b.doubt(noises[p])));
                    known_best.map_or(0.0, |stencil| stencil.slope())
                })
                .collect(),
        };
        let used: Vec<usize> =
            (0..lines.len()).filter(|&p| slopes[p].is_finite() && slopes[p] != 0.0 && lines[p].density > 0.0).collect();
        // A step that leaves the box almost everywhere would pass for one without errors.
        let mut steps = steps.to_vec();
        let fits = |stencils: &Vec<Option<LineStencil>>| {
            2 * used.iter().filter(|p| stencils[**p].is_some()).count() >= used.len()
        };
        let keep: Vec<bool> = stencils.iter().map(fits).collect();
        let mut kept = keep.iter();
        steps.retain(|_| *kept.next().unwrap_or(&false));
        let mut kept = keep.iter();
        stencils.retain(|_| *kept.next().unwrap_or(&false));
        if used.is_empty() || steps.is_empty() {
            return None;
        }
        let sums: Vec<Sums> = stencils
            .iter()
            .map(|stencils| {
                let at = |p: usize| stencils[p].map(|stencil| (stencil, noises[p], slopes[p]));
                Sums::from_points(&used.iter().filter_map(|&p| at(p)).collect::<Vec<_>>(), own.is_some())
            })
            .collect();
        let truncation = if own.is_some() {
            sums.iter().map(|sums| (sums.truncation.powi(2) - sums.of_noise.powi(2)).max(0.0).sqrt()).collect()
        } else {
            truncations(&steps, &sums)
        };
        let relative = used.iter().map(|&p| (noises[p] / lines[p].density).powi(2)).sum::<f64>() / used.len() as f64;
        let outstanding = sums.iter().position(Sums::stands_out);
        let curvature = outstanding.map_or(0.0, |s| 6.0 * truncation[s] / steps[s].powi(2));
        let each = |i: usize| DifferenceError {
            step: steps[i],
            noise: sums[i].noise,
            truncation: truncation[i],
            doubt: sums[i].doubt,
        };
        let steps = (0..steps.len()).map(each).collect();
        Some(Self { points: used.len(), noise: relative.sqrt(), curvature, steps })
    }

    /// The step with the smallest error among those that a run may take; the shortest step if all are longer.
    #[must_use]
    pub fn best(&self) -> DifferenceError {
        let least = |a: &&DifferenceError, b: &&DifferenceError| a.total().total_cmp(&b.total());
        let short = self.steps.iter().filter(|error| error.step <= LONGEST_STEP);
        *short.min_by(least).unwrap_or(&self.steps[0])
    }

    /// The error at any step: the truncation of the nearest measured step, and noise in
    /// inverse proportion to the step.
    #[must_use]
    pub fn at(&self, step: f64) -> DifferenceError {
        let distance = |e: &DifferenceError| (e.step / step).ln().abs();
        let nearest = |a: &&DifferenceError, b: &&DifferenceError| distance(a).total_cmp(&distance(b));
        let near = *self.steps.iter().min_by(nearest).expect("steps are never empty");
        DifferenceError { step, noise: near.noise * near.step / step, ..near }
    }

    /// Returns true if `step` is badly placed: it moves log10 U by more than `tolerance`, and the best step moves
    /// it by less than a third of that.
    ///
    /// The error of `step` is taken two standard errors lower, so that the answer does not
    /// depend on the choice of points.
    #[must_use]
    pub fn is_bad(&self, step: f64, tolerance: f64) -> bool {
        let (least, best) = (self.at(step).at_least(), self.best());
        least * std::f64::consts::LOG10_E > tolerance && least > FACTOR * best.total()
    }
}

/// Means of absolute errors over the points where a step fits into the box, relative to the mean of |∂σ| there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Sums {
    /// Error from noise.
    noise: f64,
    /// Error from truncation, including the noise in it.
    truncation: f64,
    /// What the truncation error would be from noise alone.
    of_noise: f64,
    /// Standard error of the truncation.
    doubt: f64,
}

impl Sums {
    /// Averages over stencils with their ε and ∂σ; `exact` if ∂σ is the field's own.
    fn from_points(points: &[(LineStencil, f64, f64)], exact: bool) -> Self {
        let scale: f64 = points.iter().map(|(_, _, slope)| slope.abs()).sum();
        let error = |(stencil, _, slope): &(LineStencil, f64, f64)| {
            if exact { (stencil.central() - slope).abs() } else { (stencil.third() * stencil.truncation()).abs() }
        };
        let sum = |of: &dyn Fn(&(LineStencil, f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / scale;
        let truncation = sum(&error);
        // Variance of a ratio of means, to first order.
        let residuals = sum(&|point| (error(point) - truncation * point.2.abs()).powi(2)) / scale;
        let noise = sum(&|(stencil, noise, _)| 0.5_f64.sqrt() * noise / stencil.h);
        // The variance of a third difference is 1 + 9 + 9 + 1 times that of the noise.
        let in_third = sum(&|(stencil, noise, _)| 20_f64.sqrt() * noise * stencil.truncation());
        Self { noise, truncation, of_noise: if exact { noise } else { in_third }, doubt: residuals.sqrt() }
    }

    /// Returns true if truncation clearly exceeds noise: by twice its variance, which is known to about that factor.
    fn stands_out(&self) -> bool {
        self.truncation.powi(2) > 2.0 * self.of_noise.powi(2)
    }
}

/// Truncation errors by increasing step.
///
/// Measured where they stand out from the noise. Below, they are continued by a power of h: at least ½ (the root
/// mean square for kinks, which are met in proportion to h), at most 2 (smooth functions). Either way they grow with
/// h. An error that the next longer step does not confirm came from one point with a kink beside it, and counts
/// only as much as there.
fn truncations(steps: &[f64], sums: &[Sums]) -> Vec<f64> {
    let measured = |s: usize| (sums[s].truncation.powi(2) - sums[s].of_noise.powi(2)).max(0.0).sqrt();
    let Some(first) = sums.iter().position(Sums::stands_out) else { return vec![0.0; steps.len()] };
    let next = (first + 1).min(steps.len() - 1);
    let power = (measured(next) / measured(first)).ln() / (steps[next] / steps[first]).ln();
    let power = if power.is_nan() { 2.0 } else { power.clamp(0.5, 2.0) };
    let below = |s: usize| measured(first) * (steps[s] / steps[first]).powf(power);
    let confirmed = |s: usize| measured(s).min(measured((s + 1).min(steps.len() - 1)));
    (0..steps.len()).map(|s| if s < first { below(s) } else { confirmed(s) }).collect()
}

/// A line along an axis through a point.
struct Line {
    x: Vec3,
    axis: usize,
    /// Lattice edge along the axis here, in scene units.
    edge: f64,
    /// Spacing of positions that f32 holds exactly here, in scene units.
    unit: f64,
    /// σ at the point.
    density: f64,
}

impl Line {
    /// Makes the line; `None` if the point, once rounded, lies outside the box, or if
    /// the lattice has no extent there.
    fn through(x: Vec3, axis: usize, lattice: &Differences, bounds: &Aabb) -> Option<Self> {
        let edge = lattice.at(x)[axis];
        let largest = f64::from(x[axis].abs()).max(edge);
        // The spacing of f32 numbers just above the next power of two: coarse enough for all positions nearby.
        let unit = 2.0_f64.powi(largest.log2().ceil() as i32 - 23);
        // Tables and stencils start on a multiple of a coarse unit, so that all their positions are exact.
        let mut x = x;
        x[axis] = ((f64::from(x[axis]) / unit).round() * unit) as f32;
        (bounds.contains(x) && edge > 0.0).then_some(Self { x, axis, edge, unit, density: 0.0 })
    }

    fn at(&self, distance: f64) -> Vec3 {
        let mut y = self.x;
        y[self.axis] = (f64::from(y[self.axis]) + distance) as f32;
        y
    }
}

/// Values of a function at −h, −h/3, h/3 and h.
#[derive(Clone, Copy)]
struct LineStencil {
    values: [f64; 4],
    h: f64,
}

impl LineStencil {
    /// f′ as a central difference over ±h.
    fn central(&self) -> f64 {
        (self.values[3] - self.values[0]) / (2.0 * self.h)
    }

    /// f(h) − 3 f(h/3) + 3 f(−h/3) − f(−h) = (2h/3)³ f‴.
    fn third(&self) -> f64 {
        let [a, b, c, d] = self.values;
        d - 3.0 * c + 3.0 * b - a
    }

    /// Factor from the third difference to the truncation error f‴ h² / 6 of a central difference over ±h.
    fn truncation(&self) -> f64 {
        27.0 / (8.0 * 6.0 * self.h)
    }

    /// f′ to fourth order: 9/8 of the narrow difference less 1/8 of the wide one.
    fn slope(&self) -> f64 {
        let [a, b, c, d] = self.values;
        (27.0 * (c - b) - (d - a)) / (16.0 * self.h)
    }

    /// Estimated error of [`LineStencil::slope`].
    fn doubt(&self, noise: f64) -> f64 {
        (self.third() * self.truncation()).abs() + 2.0 * noise / self.h
    }
}

/// Densities of the field at `places` of every line.
fn densities<const N: usize>(
    field: &dyn RadianceField,
    lines: &[Line],
    places: impl Fn(&Line) -> [Vec3; N] + Sync,
) -> Vec<[f64; N]> {
    let batches = lines.par_chunks(BATCH).flat_map_iter(|lines| {
        let positions: Vec<Vec3> = lines.iter().flat_map(&places).collect();
        let mut densities = vec![0.0; positions.len()];
        field.densities(&positions, &mut densities);
        densities.as_chunks::<N>().0.iter().map(|values| values.map(f64::from)).collect::<Vec<_>>()
    });
    batches.collect()
}

/// ∂σ along every line's axis, if the field can compute it.
fn own_slopes(field: &dyn RadianceField, lines: &[Line]) -> Option<Vec<f64>> {
    let own = field.differentiable()?;
    let batches = lines.par_chunks(BATCH).flat_map_iter(|lines| {
        let positions: Vec<Vec3> = lines.iter().map(|line| line.x).collect();
        let (mut densities, mut gradients) = (vec![0.0; positions.len()], vec![Vec3::ZERO; positions.len()]);
        own.density_jets(&positions, &mut densities, &mut gradients);
        lines.iter().zip(gradients).map(|(line, gradient)| f64::from(gradient[line.axis])).collect::<Vec<_>>()
    });
    Some(batches.collect())
}

/// ε of every line, from the narrowest table that shows it; at least the rounding of f32.
fn noises(field: &dyn RadianceField, lines: &mut [Line]) -> Vec<f64> {
    let bounds = field.bounds();
    let mut found: Vec<Option<f64>> = vec![None; lines.len()];
    for spacing in SPACINGS {
        let places = |line: &Line| {
            let apart = f64::from(spacing).exp2() * line.unit;
            std::array::from_fn::<_, TABLE, _>(|i| line.at((i as f64 - (TABLE / 2) as f64) * apart))
        };
        let tables = densities(field, lines, places);
        for ((line, values), found) in lines.iter_mut().zip(&tables).zip(&mut found) {
            line.density = values[TABLE / 2];
            // A face of the box would pass for noise.
            let inside = places(line).into_iter().all(|x| bounds.contains(x));
            let usable = inside && found.is_none() && values.iter().all(|v| v.is_finite());
            *found = found.or_else(|| usable.then(|| noise_level(values)).flatten());
        }
    }
    // Half a unit in the last place, uniformly distributed: 2⁻²⁴ / √12 of a value just below a power of two.
    let rounding = 2.0_f64.powi(-24) / 12.0_f64.sqrt();
    found.iter().zip(&*lines).map(|(noise, line)| noise.unwrap_or(0.0).max(rounding * line.density)).collect()
}

/// Values around every line's point, at distances that f32 positions hold exactly; `None` where the points leave
/// the box or a value is not finite.
fn stencils(field: &dyn RadianceField, lines: &[Line], step: f64) -> Vec<Option<LineStencil>> {
    let bounds = field.bounds();
    let h = |line: &Line| ((step * line.edge / (3.0 * line.unit)).round().max(1.0)) * 3.0 * line.unit;
    let places = |line: &Line| [-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0].map(|k| line.at(k * h(line)));
    let values = densities(field, lines, places);
    let stencil = |(line, values): (&Line, &[f64; 4])| {
        let sound = values.iter().all(|v| v.is_finite()) && places(line).into_iter().all(|x| bounds.contains(x));
        sound.then_some(LineStencil { values: *values, h: h(line) })
    };
    lines.iter().zip(&values).map(stencil).collect()
}

#[cfg(test)]
mod tests;
