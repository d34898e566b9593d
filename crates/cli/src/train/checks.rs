//! What is checked before training, and of what came of it.

use glam::{DVec3, Vec3};

use super::LOOK_PIXELS;
use super::member::Member;
use octobayes::estimate::Framing;
use octobayes::geometry::{Aabb, Camera, Domain};
use octobayes::{Error, Result};
use octobayes_models::HashGrid;
use octobayes_train::{DatasetFiles, Quality, Shot, one_color};

/// A model has learnt nothing if it is less than this many dB better than one colour for all images. At 1 dB a
/// fifth of the squared error is gone.
const ONE_COLOR_MARGIN: f64 = 1.0;
/// The same for images of one colour: less is wrong by more than a tenth of the range of colours, dB.
const OF_ONE_COLOR: f64 = 20.0;

/// Refuses cameras whose rays all miss the space to be trained. Warns if few meet it.
pub(super) fn check_framing(train: &[Shot], domain: &Domain) -> Result<()> {
    let cameras: Vec<Camera> = train.iter().map(|shot| shot.camera).collect();
    let (bounds, is_all) = match domain {
        Domain::Box(bounds) => (*bounds, true),
        // The pictures should show what is not contracted, but there is something to see outside it, too.
        Domain::Contracted { center, radius, .. } => {
            let (center, half) = (DVec3::from(*center), DVec3::splat(*radius));
            (Aabb::new(center - half, center + half)?, false)
        }
    };
    note_contracted_cameras(&cameras, domain);
    let framing = Framing::from_cameras(&cameras, &bounds);
    let Some(causes) = framing.causes() else { return Ok(()) };
    let measured = framing.measured();
    if is_all && framing.is_empty() {
        let expected = format!("rays that meet the box (--box); likely causes: {causes}");
        return Err(Error::setting("cameras", expected, format!("none: {measured}")));
    }
    announce!("warning: the cameras see little of the space to be trained: {measured}; likely causes: {causes}");
    Ok(())
}

/// Says where the scene is, if that is the camera file's word and not the usual place.
pub(super) fn note_box(bounds: Aabb, files: &DatasetFiles) {
    if bounds == files.bounds && bounds != DatasetFiles::unit_cube() {
        let [low, high] = [bounds.min(), bounds.max()];
        announce!("note: the scene is from {low:.3} to {high:.3}, by the camera file (--box for another box)");
    }
}

/// Says on stderr if cameras stand where space is contracted: what they see from nearby has fewer cells than it could.
fn note_contracted_cameras(cameras: &[Camera], domain: &Domain) {
    let outside = cameras.iter().filter(|camera| domain.stretch(camera.position.as_vec3()) > 1.0).count();
    if outside > 0 {
        let (low, high) = cameras
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), c| (l.min(c.position), h.max(c.position)));
        let [x, y, z] = (0.5 * (low + high)).to_array();
        let radius = 0.5 * (high - low).length();
        announce!(
            "note: {outside} of {} cameras stand where space is contracted; a ball of {x:.3},{y:.3},{z:.3},{radius:.3} \
             in --contract would hold them all",
            cameras.len()
        );
    }
}

/// Warns if a model shows images hardly better than a single colour would: images by name, and how well it shows them.
pub(super) fn warn_of_one_color(images: [(&str, &[Shot], Option<Quality>); 2], background: Vec3) {
    for (what, shots, shown) in images {
        let Some(shown) = shown else { continue };
        let Some(constant) = one_color(shots, background, LOOK_PIXELS) else { continue };
        let (shown, constant) = (shown.psnr, constant.psnr);
        // A single colour shows images of one colour exactly, which no model does.
        let (least, gives) = if constant.is_finite() {
            (constant + ONE_COLOR_MARGIN, format!("gives {constant:.1} dB"))
        } else {
            (OF_ONE_COLOR, "shows them exactly".into())
        };
        if shown < least {
            announce!(
                "warning: {what} images are shown with {shown:.1} dB, one colour for all {gives}; \
                 likely causes: camera axes, units or --box, or too few steps or views"
            );
            return;
        }
    }
}

/// Refuses to replace a file other than a model of `train` by a member, whose file no argument names.
pub(super) fn check_member(member: &Member) -> Result<()> {
    let is_model = |field: HashGrid| field.training().is_object();
    if !member.path.exists() || HashGrid::read(&member.path).is_ok_and(is_model) {
        return Ok(());
    }
    let found = format!("another file at {}", member.path.display());
    Err(Error::setting("--members", "nothing where members are written, or models of `train`", found))
}

/// Whether the same command has written this model before, and is done with it.
pub(super) fn is_finished(member: &Member) -> bool {
    let is_same = |field: HashGrid| {
        let mut settings = member.description.as_object().into_iter().flatten();
        settings.all(|(what, value)| field.training().get(what) == Some(value))
    };
    !member.state.path.exists() && HashGrid::read(&member.path).is_ok_and(is_same)
}
