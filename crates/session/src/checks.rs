//! Messages of the checks before a run, and about its result.

use super::training_args::TrainingArgs;
use octobayes::error::counted;
use octobayes::estimate::{CoverageCheck, Model};
use octobayes::geometry::{Camera, Mask, kept_pixels};
use octobayes::monitor::{Message, Monitor};
use octobayes::posterior::Pooling;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::{Frame, ResolutionSource, Views, check_masks};
use octobayes_next_view::{Around, NextView, Settings};

/// Fewer rays per vertex than this gain from pooling (`experiments/speed_vs_error.md`).
const MIN_RAYS_PER_VERTEX: u64 = 4;
/// Sides from which a model is looked at, on a level circle, and pixels of each look.
const SIDES: u32 = 8;
const SIDE_PIXELS: u64 = 1024;
/// Share of a side's surface above which it is worth a warning that no ray reached it: lego from all round has 0.01
/// with a million rays and 0.08 with a tenth of them, lego from twelve views on one side 0.26.
const MUCH_UNSEEN: f64 = 0.15;

/// Refuses masks that leave nothing. Notes what they leave out.
pub fn masks(views: &Views, masks: &[Option<Mask>], tell: &mut dyn FnMut(Message)) -> Result<()> {
    check_masks(&views.path, masks)?;
    let masked = masks.iter().flatten().count();
    if masked > 0 {
        let cameras = views.cameras();
        let all: u64 = cameras.iter().map(Camera::pixels).sum();
        let left_out = 100.0 * (1.0 - kept_pixels(&cameras, masks) as f64 / all as f64);
        let frames = counted(cameras.len(), "frame");
        tell(Message::Note(format!("masks of {masked} of {frames} leave out {left_out:.1} % of the pixels")));
    }
    Ok(())
}

/// Warns if the number of training pixels, by which the scale of the data weighs them, follows from an image size that
/// is not known.
pub fn pixels(views: &Views, pixels: u64, tell: &mut dyn FnMut(Message)) {
    if views.resolution_source == ResolutionSource::Assumed {
        let [w, h] = views.frames[0].camera.resolution;
        tell(Message::Warning(format!(
            "the size of the training images is not known: --scale data counts {pixels} training pixels, as for {w} x \
             {h}. With sides k times as long, constrained U would be k times as small"
        )));
    }
}

/// Warns if the cameras have another size than the images of the training, as its settings and the pictures have it.
pub fn sizes(args: &TrainingArgs, views: &Views, tell: &mut dyn FnMut(Message)) {
    let of = |frame: &Frame| Some((frame.camera.resolution, args.size(&frame.image, frame.size)?));
    let is_other = |(own, trained): &([u32; 2], [u32; 2])| own.iter().zip(trained).any(|(a, b)| a.abs_diff(*b) > 1);
    if let Some(([w, h], [width, height])) = views.frames.iter().filter_map(of).find(is_other) {
        let path = args.path.display();
        tell(Message::Warning(format!(
            "{path}: the splats were trained at {width} x {height}, but the cameras have {w} x {h} pixels: splats are \
             right only at the size of their training (--resolution {width}x{height})"
        )));
    }
}

/// Refuses a run in which nothing is seen. Warns of one in which little is seen, for likely causes beside those that
/// were measured.
pub fn sight(sight: &CoverageCheck, others: &[&str], tell: &mut dyn FnMut(Message)) -> Result<()> {
    if let Some(outside) = sight.cut_off().map(|share| 100.0 * share) {
        let text = format!("{outside:.1} % of what the rays meet lies outside --box: U is the prior there");
        tell(Message::Note(text));
    }
    let Some(causes) = sight.causes() else { return Ok(()) };
    let (causes, measured) = ([&[causes.as_str()], others].concat().join(", or "), sight.measured());
    if sight.is_empty() {
        let expected = format!("rays that meet matter in the field's domain; likely causes: {causes}");
        return Err(Error::setting("cameras", expected, format!("none: {measured}")));
    }
    tell(Message::Warning(format!("the cameras see little of the model: {measured}; likely causes: {causes}")));
    Ok(())
}

/// Warns of a model whose one side was never seen, if training puts matter there all the same, as it does with splats:
/// a pixel's little light through those in front makes them look more certain than space that no ray reached.
///
/// # Errors
/// [`Error::Interrupted`] only.
pub fn unseen(
    model: &dyn Model,
    field: &UncertaintyField,
    cameras: &[Camera],
    monitor: &dyn Monitor,
    tell: &mut dyn FnMut(Message),
) -> Result<()> {
    if model.centers().is_empty() {
        return Ok(());
    }
    let Ok(around) = Around::like(cameras, field.lattice().domain(), None) else { return Ok(()) };
    // Of a part of a run it is not known where all of its rays passed.
    if field.record().is_part() {
        return Ok(());
    }
    let sides = around.orbit(SIDES);
    let looks = NextView::new(model, field, &sides).monitor(monitor);
    let shares = looks.settings(Settings::default().pixels(SIDE_PIXELS)).unseen()?;
    let most = shares.into_iter().flatten().fold(0.0, f64::max);
    if most > MUCH_UNSEEN {
        tell(Message::Warning(format!(
            "from one side, {:.0} % of the surface that shows was never seen by a training ray: splats are made up \
             there, whatever their U. Pictures hatch them, `query` and `export` call them unseen, --threshold removes \
             them",
            100.0 * most
        )));
    }
    Ok(())
}

/// Notes what is odd about a finished field. `could_pool`: whether its run would accept pooling.
pub fn field(field: &UncertaintyField, pooling: Pooling, could_pool: bool, tell: &mut dyn FnMut(Message)) {
    if let Some(median) = field.median_rays().filter(|&median| median < MIN_RAYS_PER_VERTEX && !pooling.is_on()) {
        let few = match median {
            0 | 1 => "at most one ray".into(),
            rays => format!("{rays} rays or fewer"),
        };
        let way_out = if could_pool { "--pooling auto uses what their neighbours saw, " } else { "" };
        tell(Message::Note(format!(
            "half of the vertices that moved are supported by {few}; {way_out}more --rays is better"
        )));
    }
}
