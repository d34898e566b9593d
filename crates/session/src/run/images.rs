//! The images beside the cameras, held against the model before a run, and those of its training.

use glam::Vec3;

use super::{Prepared, Session};
use crate::training_args::TrainingArgs;
use crate::{checks, world};
use octobayes::Result;
use octobayes::estimate::{Model, RaySettings};
use octobayes::monitor::{Message, Monitor};
use octobayes_data::Frame;
use octobayes_depth::{Compared, TrainingImages};
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
        let renderer = model.for_images(&rays, None, monitor)?;
        let (known, offset) = (model.training_cameras(), rays.offset_for(model));
        let found = check_images(&*renderer, known, self.frames_with_images(), offset, None, monitor)?;
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

    /// The frames whose images are compared with the model before the run.
    pub(super) fn frames_with_images(&self) -> &[Frame] {
        self.images.as_ref().map_or(&*self.views.frames, TrainingImages::frames)
    }
}

impl Prepared<'_> {
    /// Compares the model with the images beside the cameras. Refuses cameras whose images it does not show at all,
    /// unless forced. Warns if it shows them poorly, and of splats that may lie in another frame, unless the images
    /// fit or the message was sent already. Notes how well splats show them.
    pub(super) fn check_images(&mut self, is_frame_open: bool, tell: &mut dyn FnMut(Message)) -> Result<()> {
        let (session, stream) = (self.session, self.run.stream());
        let (frames, offset, room) = (session.frames_with_images(), stream.pixel_offset, self.run.room_for_pictures());
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

    /// Compares the model with its training images, if they were given.
    pub(super) fn compared(&self) -> Result<Option<Compared>> {
        let Some(images) = &self.session.images else { return Ok(None) };
        let of_run = self.session.rays;
        let settings = RaySettings::for_images()
            .background(self.session.background.unwrap_or(of_run.background))
            .occupancy(of_run.occupancy)
            .march_step(of_run.march_step)
            .pixel_offset(of_run.pixel_offset);
        let renderer = self.model.for_images(&settings, None, self.monitor)?;
        images.compare(&*renderer, settings.offset_for(self.model), self.run.lattice(), self.monitor).map(Some)
    }
}
