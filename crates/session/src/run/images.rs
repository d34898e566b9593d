//! The images beside the cameras, held against the model before a run.

use glam::Vec3;

use super::{Prepared, Session};
use crate::training_args::TrainingArgs;
use crate::{checks, world};
use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::monitor::{Message, Monitor};
use octobayes::posterior::DataScale;
use octobayes_evaluation::{ImageCheck, check_images};

impl Session {
    /// The settings of rays with the background that is used; and the comparison of splats with their images in front
    /// of it, if that decided.
    pub(super) fn settled(
        &self,
        model: &dyn Model,
        monitor: &dyn Monitor,
        tell: &mut dyn FnMut(Message),
    ) -> Result<(RaySettings, Option<ImageCheck>)> {
        let rays = self.rays.background(self.background.unwrap_or(self.rays.background));
        if !model.leaves_background_open() {
            return Ok((rays, None));
        }
        let name = |color: Vec3| if color == Vec3::ONE { "white" } else { "black" };
        let args = TrainingArgs::beside(&self.files_of_training());
        if let Some(args) = &args {
            checks::sizes(args, &self.views, tell);
        }
        if let Some((args, own)) = args.as_ref().and_then(|args| Some((args, args.background()?))) {
            let (path, own_name) = (args.path.display(), name(own));
            match self.background {
                None => tell(Message::Note(format!("{path}: {own_name} lay behind the splats (--background)"))),
                Some(chosen) if chosen != own => tell(Message::Warning(format!(
                    "{path}: {own_name} lay behind the splats in training, but not by --background"
                ))),
                Some(_) => {}
            }
            return Ok((rays.background(self.background.unwrap_or(own)), None));
        }
        if self.background.is_some() {
            return Ok((rays, None));
        }
        self.cameras.iter().try_for_each(|camera| model.check_camera(camera))?;
        let renderer = model.for_images(&rays, monitor)?;
        let (known, offset) = (model.training_cameras(), rays.offset_for(model));
        let found = check_images(&*renderer, known, &self.views.frames, offset, None, monitor)?;
        if let Some((best, [psnr, other])) = found.as_ref().and_then(ImageCheck::clear_background) {
            tell(Message::Note(format!(
                "{} lay behind the splats by the images beside the cameras: {psnr:.1} dB, {other:.1} dB otherwise \
                 (--background)",
                name(best)
            )));
            return Ok((rays.background(best), found.filter(|_| best == rays.background)));
        }
        tell(Message::Note(format!(
            "it is not known what lay behind the splats in training: {} is assumed; the original code has black \
             unless `white_background` is set (--background)",
            name(rays.background)
        )));
        Ok((rays, found))
    }

    /// The noise that training left by some pixels of the images beside the cameras, which `images` gets; `None`
    /// without any.
    pub(super) fn noise_of_images(
        &self,
        model: &dyn Model,
        rays: &RaySettings,
        images: &mut Option<ImageCheck>,
        monitor: &dyn Monitor,
        tell: &mut dyn FnMut(Message),
    ) -> Result<Option<f64>> {
        if images.is_none() {
            let (renderer, offset) = (model.for_images(rays, monitor)?, rays.offset_for(model));
            let (known, room) = (model.training_cameras(), self.grid.memory);
            *images = check_images(&*renderer, known, &self.views.frames, offset, room, monitor)?;
        }
        let Some(found) = images.as_ref().filter(|found| found.psnr.is_finite()) else { return Ok(None) };
        let (least, most) = DataScale::NOISE.into_inner();
        // As the note has it, so that who passes it gets the same run, and so do shards on other machines.
        let noise = (1e6 * DataScale::noise_of(found.psnr)).round() / 1e6;
        let noise = noise.clamp(least, most);
        tell(Message::Note(format!(
            "the model shows its training images with {:.1} dB, by {} pixels: --noise {noise}",
            found.psnr, found.pixels
        )));
        Ok(Some(noise))
    }
}

impl Prepared<'_> {
    /// Compares the model with the images beside the cameras. Refuses cameras whose images it does not show at all,
    /// unless forced. Warns if it shows them poorly, and of splats that may lie in another frame, unless the images
    /// fit or the message was sent already. Notes how well splats show them.
    pub(super) fn check_images(&mut self, is_frame_open: bool, tell: &mut dyn FnMut(Message)) -> Result<()> {
        let (session, stream) = (self.session, self.run.stream());
        let (frames, offset, room) = (&*session.views.frames, stream.pixel_offset, self.run.room_for_pictures());
        let found = match self.images.take() {
            Some(found) => Some(found),
            None => check_images(&*stream.source, self.model.training_cameras(), frames, offset, room, self.monitor)?,
        };
        let are_shown = found.as_ref().is_some_and(|found| found.warnings().is_empty());
        if let Some(frame) = (is_frame_open && !are_shown)
            .then(|| world::other_frame(self.model.centers(), &session.views))
            .transpose()?
            .flatten()
        {
            tell(Message::Warning(format!("probably {frame}")));
        }
        let Some(found) = found else { return Ok(()) };
        if !session.force {
            found.refuse()?;
        }
        let warnings = found.warnings();
        found.note().filter(|_| warnings.is_empty()).into_iter().for_each(|text| tell(Message::Note(text)));
        warnings.into_iter().for_each(|text| tell(Message::Warning(text)));
        self.images = Some(found);
        Ok(())
    }
}
