//! From the numbers of a file to splats that renderers accept: what is dropped, and what is brought into range.

use std::path::Path;

use glam::{Quat, Vec3, Vec4};

use super::super::columns::Layout;
use super::super::{RenderMode, Splats};
use octobayes::{Error, Result};

/// Of so many splats one may be unusable. Training leaves a few NaN; files with more are damaged.
const ONE_IN: usize = 100;
/// Largest coordinate of a mean. Distances beyond overflow f32 when they are squared.
const FARTHEST: f32 = 1e15;
/// Largest logarithm of a scale, for the same reason.
const LARGEST_LOG_SCALE: f32 = 34.0;
/// Logarithm that stands for a scale of 0, which flat splats have. Its square is still a normal f32.
const FLAT: f32 = -30.0;
/// Logit that stands for full opacity: 1 − 10⁻⁶, as in other readers. Renderers stop at 0.99.
const OPAQUE: f32 = 13.815_51;

/// The numbers of a file, `[n]` each, as [`Splats::new`] takes them but unchecked.
pub(super) struct Raw {
    pub means: Vec<Vec3>,
    pub log_scales: Vec<Vec3>,
    /// x, y, z, w; of any length.
    pub rotations: Vec<Vec4>,
    pub opacity_logits: Vec<f32>,
    pub sh: Vec<f32>,
    pub degree: u8,
    pub mode: RenderMode,
}

/// The logit of an opacity, between those of 10⁻⁶ and 1 − 10⁻⁶.
pub(super) fn logit(opacity: f64) -> f32 {
    (opacity.ln() - (1.0 - opacity).ln()).clamp(-f64::from(OPAQUE), f64::from(OPAQUE)) as f32
}

impl Raw {
    /// Smooths every splat by an isotropic Gaussian of deviation `radius(i)`, as Mip-Splatting's renderer does (Yu et
    /// al., 2024, §4.1): s² + f², and opacities times √(det / det').
    pub fn filter(&mut self, radius: impl Fn(usize) -> f64) {
        for (i, (scales, logit)) in self.log_scales.iter_mut().zip(&mut self.opacity_logits).enumerate() {
            let f = radius(i);
            if f == 0.0 {
                continue;
            }
            let before = scales.as_dvec3();
            let after = (2.0 * before).exp() + f * f;
            let after = 0.5 * after.map(f64::ln);
            *scales = after.as_vec3();
            // o exp(−d), whose logit needs 1 − o exp(−d) without cancellation.
            let (x, d) = (f64::from(*logit), (after - before).element_sum());
            let ln_opacity = -(-x).exp().ln_1p();
            let rest = 1.0 / (1.0 + x.exp()) - ln_opacity.exp() * (-d).exp_m1();
            *logit = (ln_opacity - d - rest.ln()) as f32;
        }
    }

    /// Splats of these numbers, with the layout of their file, or else that of the original code, and with the notes
    /// of its reader before those of dropped and replaced numbers.
    ///
    /// # Errors
    /// If there are none, or if more than one in [`ONE_IN`] is unusable.
    pub fn finish(mut self, path: &Path, layout: Option<Layout>, mut notes: Vec<String>) -> Result<Splats> {
        let n = self.means.len();
        if n == 0 {
            return Err(Error::malformed(path, "number of splats", "at least one", "0"));
        }
        self.replace_infinities(&mut notes);
        let unusable: Vec<Option<(&str, f32)>> = (0..n).map(|i| self.unusable(i)).collect();
        let mut all = unusable.iter().enumerate().filter_map(|(i, found)| found.map(|found| (i, found)));
        let first = all.next();
        let count = first.map_or(0, |_| 1 + all.count());
        if let Some((i, (what, found))) = first {
            if count * ONE_IN > n {
                let expected =
                    format!("numbers that renderers can use in all but 1 % of {n} splats (those few are dropped)");
                return Err(Error::malformed(
                    path,
                    format!("splat {i}, {what}"),
                    expected,
                    format!("{found}, {count} such splats"),
                ));
            }
            let them = if count == 1 { "splat is" } else { "splats are" };
            notes.push(format!("{count} of {n} {them} dropped: splat {i} has {what} {found}"));
        }
        let rotations = self.rotations.iter().map(|q| unit(*q)).collect();
        let (degree, mode) = (self.degree, self.mode);
        let layout = layout.unwrap_or_else(|| Layout::original(degree, n));
        let splats = Splats {
            means: self.means,
            log_scales: self.log_scales,
            rotations,
            opacity_logits: self.opacity_logits,
            sh: self.sh,
            degree,
            mode,
            layout,
            notes,
        };
        if count == 0 { Ok(splats) } else { splats.keep(&unusable.iter().map(Option::is_none).collect::<Vec<_>>()) }
    }

    /// Gives infinities that mean something the largest or smallest number that acts alike.
    fn replace_infinities(&mut self, notes: &mut Vec<String>) {
        let mut count = 0;
        for logit in &mut self.opacity_logits {
            if logit.is_infinite() {
                *logit = OPAQUE.copysign(*logit);
                count += 1;
            }
        }
        if count > 0 {
            notes.push(format!("{count} opacities are infinite; ±{OPAQUE} takes their place"));
        }
        let mut flat = 0;
        for scale in self.log_scales.iter_mut().flat_map(<Vec3 as AsMut<[f32; 3]>>::as_mut) {
            if *scale == f32::NEG_INFINITY {
                *scale = FLAT;
                flat += 1;
            }
        }
        if flat > 0 {
            notes.push(format!("{flat} scales are 0; e^{FLAT} takes their place"));
        }
    }

    /// What makes splat `i` unusable, and the number.
    fn unusable(&self, i: usize) -> Option<(&'static str, f32)> {
        let beyond = |what: &'static str, values: &[f32], fits: &dyn Fn(f32) -> bool| {
            values.iter().copied().find(|v| !fits(*v)).map(|found| (what, found))
        };
        let width = self.sh.len() / self.means.len();
        let finite = |v: f32| v.is_finite();
        beyond("mean", &self.means[i].to_array(), &|v| v.abs() <= FARTHEST)
            .or_else(|| beyond("log scale", &self.log_scales[i].to_array(), &|v| finite(v) && v <= LARGEST_LOG_SCALE))
            .or_else(|| beyond("rotation", &self.rotations[i].to_array(), &|v| v.abs() <= FARTHEST))
            .or_else(|| beyond("opacity", &[self.opacity_logits[i]], &finite))
            .or_else(|| beyond("spherical harmonics", &self.sh[i * width..(i + 1) * width], &|v| v.abs() <= FARTHEST))
    }
}

/// A quaternion of length 1: the same bits if it has that length already, no rotation if it is 0.
///
/// The original code normalises rotations whenever it uses them, and files have them as training left them.
fn unit(q: Vec4) -> Quat {
    let wide = q.as_dvec4();
    let squared = wide.length_squared();
    if (squared - 1.0).abs() <= 1e-6 {
        return Quat::from_vec4(q);
    }
    match wide.try_normalize() {
        Some(unit) => Quat::from_vec4(unit.as_vec4()),
        None => Quat::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn raw(n: usize) -> Raw {
        Raw {
            means: vec![Vec3::ONE; n],
            log_scales: vec![Vec3::ZERO; n],
            rotations: vec![Vec4::W; n],
            opacity_logits: vec![0.5; n],
            sh: vec![0.25; 3 * n],
            degree: 0,
            mode: RenderMode::Classic,
        }
    }

    fn finish(raw: Raw) -> Result<Splats> {
        raw.finish(Path::new("s.ply"), None, Vec::new())
    }

    #[test]
    fn a_few_unusable_splats_are_dropped_with_a_note() {
        let mut some = raw(300);
        (0..300).for_each(|i| some.means[i].x = i as f32);
        some.sh[3 * 7 + 1] = f32::NAN;
        some.log_scales[9].z = 35.0;
        some.means[299].x = 1e16;
        let splats = finish(some).unwrap();
        assert_eq!((splats.len(), splats.mean(7).x, splats.mean(8).x, splats.mean(296).x), (297, 8.0, 10.0, 298.0));
        assert_eq!(splats.sh(7), [0.25; 3]);
        assert_eq!(splats.notes(), ["3 of 300 splats are dropped: splat 7 has spherical harmonics NaN"]);
        let mut many = raw(300);
        (10..14).for_each(|i| many.rotations[i].w = f32::INFINITY);
        assert_eq!(
            finish(many).unwrap_err().to_string(),
            "s.ply: splat 10, rotation: expected numbers that renderers can use in all but 1 % of 300 splats (those \
             few are dropped), found inf, 4 such splats"
        );
        assert!(finish(raw(0)).unwrap_err().to_string().contains("at least one, found 0"));
    }

    #[test]
    fn infinities_that_mean_something_are_replaced() {
        let mut some = raw(2);
        some.opacity_logits = vec![f32::INFINITY, f32::NEG_INFINITY];
        some.log_scales[1].y = f32::NEG_INFINITY;
        let splats = finish(some).unwrap();
        assert_eq!(splats.opacity_logits(), [OPAQUE, -OPAQUE]);
        assert!((f64::from(splats.opacity(0)) - (1.0 - 1e-6)).abs() < 1e-7 && splats.opacity(1) < 1.01e-6);
        assert_eq!((splats.log_scales()[1].y, splats.notes().len()), (FLAT, 2));
        assert!(splats.scale(1).y.powi(2) > f32::MIN_POSITIVE);
        assert_eq!([0.0, 0.5, 1.0].map(logit), [-OPAQUE, 0.0, OPAQUE]);
    }

    #[test]
    fn filters_change_scales_and_opacities() {
        let mut some = raw(5);
        let filters = [0.0, 0.75, 1e-4, 2.0, f64::NAN];
        some.log_scales[1] = Vec3::new(0.0, -2.0, 1.0);
        some.opacity_logits[2] = 30.0;
        some.log_scales[3] = Vec3::splat(f32::NEG_INFINITY);
        some.filter(|i| filters[i]);
        assert_eq!((some.log_scales[0], some.opacity_logits[0]), (Vec3::ZERO, 0.5), "bit for bit");
        let s = [1.0, (-2.0_f64).exp(), 1.0_f64.exp()];
        let grown = s.map(|s| (s * s + 0.5625).sqrt());
        for (axis, grown) in grown.iter().enumerate() {
            assert!((f64::from(some.log_scales[1][axis]) - grown.ln()).abs() < 1e-6);
        }
        let opacity = 1.0 / (1.0 + (-0.5_f64).exp()) * s.iter().product::<f64>() / grown.iter().product::<f64>();
        assert!((f64::from(some.opacity_logits[1]) - (opacity / (1.0 - opacity)).ln()).abs() < 1e-6);
        // 1 − o is 1e-13, and 1.5e-8 of o is lost to the filter.
        let expected = -f64::ln((-30.0_f64).exp() + 1.5e-8);
        assert!((f64::from(some.opacity_logits[2]) - expected).abs() < 1e-4, "{}", some.opacity_logits[2]);
        // A point without extent is invisible, and has the filter's size.
        assert_eq!(some.opacity_logits[3], f32::NEG_INFINITY);
        assert!((some.log_scales[3].x - 2_f32.ln()).abs() < 1e-6 && some.log_scales[4].x.is_nan());
    }

    #[test]
    fn rotations_are_normalised_once() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut random = || rng.random_range(-1.0..1.0);
        for _ in 0..1000 {
            let q = unit(1e3 * Vec4::new(random(), random(), random(), random()));
            assert!((q.length() - 1.0).abs() < 1e-6);
            assert_eq!(unit(Vec4::from(q)), q, "bit for bit");
        }
        assert_eq!([unit(Vec4::ZERO), unit(Vec4::W * 3.0)], [Quat::IDENTITY; 2]);
    }
}
