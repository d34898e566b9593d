//! What the checks before a run, and its result, have to say.

use super::training_args::TrainingArgs;
use crate::dataset::{Frame, ResolutionSource, Views, check_masks};
use crate::error::counted;
use crate::estimate::{CoverageCheck, Subject};
use crate::evaluate::Remark;
use crate::geometry::{Aabb, Camera, Mask, kept_pixels};
use crate::monitor::Monitor;
use crate::next_view::{Around, NextView, Settings};
use crate::posterior::Pooling;
use crate::splats::{NEAR, Splats, share_too_near};
use crate::uncertainty::UncertaintyField;
use crate::{Error, Result};

/// Fewer rays per vertex than this gain from pooling (`experiments/speed_vs_error.md`).
const MIN_RAYS_PER_VERTEX: u64 = 4;
/// A share of splats that are too near to be drawn, above which they are no mere floaters.
const MOST_TOO_NEAR: f64 = 0.02;
/// Least share of opaque splats within the box of what the cameras see. Four trainings of a hundred, ten and twelve
/// views have 0.997 to 1; with cameras at a quarter of their distance 0.51 to 0.64.
const LEAST_INSIDE: f64 = 0.8;
/// Sides from which splats are looked at, on a level circle, and pixels of each look.
const SIDES: u32 = 8;
const SIDE_PIXELS: u64 = 1024;
/// Share of a side's surface above which it is worth a warning that no ray reached it: lego from all round has 0.01
/// with a million rays and 0.08 with a tenth of them, lego from twelve views on one side 0.26.
const MUCH_UNSEEN: f64 = 0.15;

/// Refuses masks that leave nothing. Notes what they leave out.
pub fn masks(views: &Views, masks: &[Option<Mask>], tell: &mut dyn FnMut(Remark)) -> Result<()> {
    check_masks(&views.path, masks)?;
    let masked = masks.iter().flatten().count();
    if masked > 0 {
        let cameras = views.cameras();
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let left_out = 100.0 * (1.0 - kept_pixels(&cameras, masks) as f64 / all as f64);
        let frames = counted(cameras.len(), "frame");
        tell(Remark::Note(format!("masks of {masked} of {frames} leave out {left_out:.1} % of the pixels")));
    }
    Ok(())
}

/// Warns if the number of training pixels, by which the scale of the data weighs them, follows from an image size that
/// nobody knows.
pub fn pixels(views: &Views, pixels: u64, tell: &mut dyn FnMut(Remark)) {
    if views.resolution_source == ResolutionSource::Assumed {
        let [w, h] = views.frames[0].camera.resolution;
        tell(Remark::Warning(format!(
            "the size of the training images is not known: --scale data counts {pixels} training pixels, as for {w} x \
             {h}. With sides k times as long, constrained U would be k times as small"
        )));
    }
}

/// Warns if the cameras have another size than the images of the training, as its settings and the pictures have it.
pub fn sizes(args: &TrainingArgs, views: &Views, tell: &mut dyn FnMut(Remark)) {
    let of = |frame: &Frame| Some((frame.camera.resolution, args.size(&frame.image, frame.size)?));
    let is_other = |(own, trained): &([u32; 2], [u32; 2])| own.iter().zip(trained).any(|(a, b)| a.abs_diff(*b) > 1);
    if let Some(([w, h], [width, height])) = views.frames.iter().filter_map(of).find(is_other) {
        let path = args.path.display();
        tell(Remark::Warning(format!(
            "{path}: the splats were trained at {width} x {height}, but the cameras have {w} x {h} pixels: splats are \
             right only at the size of their training (--resolution {width}x{height})"
        )));
    }
}

/// Refuses a run in which nothing is seen. Warns of one in which little is seen, for likely causes beside those that
/// were measured.
pub fn sight(sight: &CoverageCheck, others: &[&str], tell: &mut dyn FnMut(Remark)) -> Result<()> {
    if let Some(outside) = sight.cut_off().map(|share| 100.0 * share) {
        let text = format!("{outside:.1} % of what the rays meet lies outside --box: U is the prior there");
        tell(Remark::Note(text));
    }
    let Some(causes) = sight.causes() else { return Ok(()) };
    let (causes, measured) = ([&[causes.as_str()], others].concat().join(", or "), sight.measured());
    if sight.is_empty() {
        let expected = format!("rays that meet matter in the field's domain; likely causes: {causes}");
        return Err(Error::setting("cameras", expected, format!("none: {measured}")));
    }
    tell(Remark::Warning(format!("the cameras see little of the model: {measured}; likely causes: {causes}")));
    Ok(())
}

/// Warns of splats so near to their cameras that they are not drawn, if they are more than a few floaters.
pub fn near(splats: &Splats, cameras: &[Camera], tell: &mut dyn FnMut(Remark)) {
    let share = share_too_near(splats, cameras);
    if share > MOST_TOO_NEAR {
        tell(Remark::Warning(format!(
            "{:.0} % of the splats in front of the cameras are nearer than {NEAR} scene units and not drawn, as in the \
             original code; gsplat and nerfstudio draw from 0.01: scale splats and cameras up",
            100.0 * share
        )));
    }
}

/// Warns if the cameras, within the box of what they see, have few of the splats that training made opaque.
pub fn share(splats: &Splats, seen: &Aabb, tell: &mut dyn FnMut(Remark)) {
    let opaque: Vec<usize> = (0..splats.len()).filter(|&i| splats.opacity(i) >= 0.5).collect();
    let is_inside = |&&i: &&usize| seen.contains(splats.mean(i));
    // NaN, and no warning, if none is opaque.
    let share = opaque.iter().filter(is_inside).count() as f64 / opaque.len() as f64;
    if share < LEAST_INSIDE {
        tell(Remark::Warning(format!(
            "only {:.0} % of the opaque splats lie within what the cameras see, where a training made all of them: \
             likely causes: some of the training cameras only, or cameras of another scale or frame",
            100.0 * share
        )));
    }
}

/// Warns of splats whose one side was never seen. Trained splats show something there all the same, and a pixel's
/// little light through those in front makes them look more certain than space that no ray reached.
///
/// # Errors
/// [`Error::Interrupted`] only.
pub fn unseen(
    splats: &Splats,
    field: &UncertaintyField,
    cameras: &[Camera],
    monitor: &dyn Monitor,
    tell: &mut dyn FnMut(Remark),
) -> Result<()> {
    let Ok(around) = Around::like(cameras, field.lattice().domain(), None) else { return Ok(()) };
    // Of a part of a run it is not known where all of its rays passed.
    if field.tile().is_some() || field.record().is_part() {
        return Ok(());
    }
    let sides = around.orbit(SIDES);
    let looks = NextView::of(Subject::Splats(splats), field, &sides).monitor(monitor);
    let shares = looks.settings(Settings::default().pixels(SIDE_PIXELS)).unseen()?;
    let most = shares.into_iter().flatten().fold(0.0, f64::max);
    if most > MUCH_UNSEEN {
        tell(Remark::Warning(format!(
            "from one side, {:.0} % of the surface that shows was never seen by a training ray: splats are made up \
             there, whatever their U. Pictures hatch them, `query` and `export` call them unseen, --threshold removes \
             them",
            100.0 * most
        )));
    }
    Ok(())
}

/// Notes what is odd about a finished field. `could_pool`: whether its run would accept pooling.
pub fn field(field: &UncertaintyField, pooling: Pooling, could_pool: bool, tell: &mut dyn FnMut(Remark)) {
    if let Some(median) = field.median_rays().filter(|&median| median < MIN_RAYS_PER_VERTEX && !pooling.is_on()) {
        let few = match median {
            0 | 1 => "at most one ray".into(),
            rays => format!("{rays} rays or fewer"),
        };
        let way_out = if could_pool { "--pooling auto uses what their neighbours saw, " } else { "" };
        tell(Remark::Note(format!(
            "half of the vertices that moved are supported by {few}; {way_out}more --rays is better"
        )));
    }
    if let Some(tile) = field.tile().filter(|_| field.sums().is_some_and(|sums| sums.iter().all(|s| s.rays == 0))) {
        let text = format!("tile {tile} has no vertex that a ray touched: the scene is too small for so many tiles");
        tell(Remark::Note(text));
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Quat, Vec3};

    use super::*;
    use crate::splats::RenderMode;

    #[test]
    fn few_opaque_splats_in_the_box_are_warned_of_but_not_if_none_is_opaque() {
        let warnings = |logits: [f32; 5]| {
            let means = (0..5_u8).map(|i| Vec3::X * f32::from(i)).collect();
            let (scales, rotations) = (vec![Vec3::splat(-3.0); 5], vec![Quat::IDENTITY; 5]);
            let splats = Splats::new(means, scales, rotations, logits.to_vec(), vec![0.0; 15], 0, RenderMode::Classic);
            let (seen, mut found) = (Aabb::new(DVec3::splat(-1.0), DVec3::splat(3.5)).unwrap(), Vec::new());
            share(&splats.unwrap(), &seen, &mut |remark| found.push(remark.to_string()));
            found
        };
        // Four of five are inside; then three of four opaque ones.
        assert_eq!(warnings([1.0; 5]), [""; 0]);
        assert!(warnings([-1.0, 1.0, 1.0, 1.0, 1.0])[0].contains("only 75 % of the opaque splats"));
        assert_eq!(warnings([-1.0; 5]), [""; 0]);
    }
}
