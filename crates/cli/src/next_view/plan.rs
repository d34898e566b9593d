//! The plan as a page for people: maps, what each photograph would see, and how to get there.

use std::path::Path;

use glam::{DVec3, Vec3};
use image::{Rgb, RgbImage};

use super::candidates::Candidates;
use crate::depth::Unit;
use crate::progress::Bars;
use octobayes::error::{counted, printable};
use octobayes::geometry::{Camera, upright};
use octobayes::monitor::Monitor;
use octobayes::render::{RenderedView, Renderer};
use octobayes::{Error, Result};
use octobayes_data::{Frame, PosedImage, transforms_text};
use octobayes_next_view::{Gain, GainMap, NextView, Ranking, Step, Way};
use octobayes_show::plan_page::{PlanMap, PlanPage, PlannedView};

/// Longest side of pictures, pixels.
const SIDE: u32 = 256;
/// Training cameras through which points of the map are looked for, and the longest side of their pictures.
const LOOKS: usize = 60;
const SIDE_OF_LOOK: u32 = 72;
/// Cosine between two directions of view below which photographs hardly show the same.
const ALIKE: f64 = 0.5;
/// The colour of what was seen worst, and how much of it covers the picture there.
const TINT: Vec3 = Vec3::new(1.0, 0.0, 0.8);
const COVER: f32 = 0.65;
/// Share of the pixels with a gain that are tinted in full.
const FULL: f64 = 0.9;

/// What a plan is drawn from.
pub struct Planner<'a> {
    /// Shows images of the model.
    pub renderer: &'a dyn Renderer,
    /// Where in a pixel its ray passes.
    pub pixel_offset: f64,
    /// The training frames.
    pub training: &'a [Frame],
    /// What lengths are written in.
    pub unit: Unit,
    /// What is up, if it was given.
    pub up: Option<DVec3>,
    /// What a view is worth.
    pub gain: Gain,
    /// Progress.
    pub bars: &'a Bars,
}

impl Planner<'_> {
    /// Writes the page. `of_what` says what was chosen from.
    pub fn write(
        &self,
        path: &Path,
        title: &str,
        of_what: &str,
        next: &NextView,
        candidates: &Candidates,
        ranking: &Ranking,
    ) -> Result<()> {
        let existing: Vec<Camera> = self.training.iter().map(|frame| frame.camera).collect();
        let up = upright(&existing, self.up)?;
        let planned: Vec<(String, Camera)> = ranking
            .steps
            .iter()
            .map(|step| (candidates.names[step.index].clone(), candidates.cameras[step.index]))
            .collect();
        let cameras: Vec<Camera> = planned.iter().map(|(_, camera)| *camera).collect();
        let maps = self.maps(&existing, &cameras, up)?;
        let first = ranking.steps.first().map_or(0.0, |step| step.gain);
        let views = ranking.steps.iter().zip(&planned);
        let views = views.map(|(step, (name, camera))| self.view(next, step, first, name, camera, up));
        let mut lead = vec![format!(
            "{} to add to {}, chosen from {of_what}. Each is worth most beside those before it.",
            counted(planned.len(), "photograph"),
            counted(self.training.len(), "photograph")
        )];
        if self.gain != Gain::Coverage {
            lead.push(
                "Magenta is what a photograph would determine better: the stronger, the less the photographs so far \
                 hold it in place. Other colours are the model's: what is there may look otherwise."
                    .into(),
            );
        }
        if !self.unit.is_known {
            lead.push("The unit of the cameras is not known: all lengths are scene units.".into());
        }
        let page = PlanPage {
            title: title.rsplit(['/', '\\']).next().unwrap_or(title),
            lead,
            maps,
            views: views.collect::<Result<_>>()?,
            cameras: transforms_text(&planned),
        };
        page.write(path)
    }

    /// The scene from above and from the side, as the first photograph looks.
    fn maps(&self, existing: &[Camera], planned: &[Camera], up: DVec3) -> Result<Vec<PlanMap>> {
        let points = self.points(existing)?;
        let ahead = Way::level(&existing[0], up);
        let right = ahead.cross(up);
        // Under a roof nothing else would be seen.
        let highest = existing.iter().chain(planned).map(|camera| camera.position.dot(up)).fold(f64::MIN, f64::max);
        let below: Vec<(DVec3, [u8; 3])> = points.iter().copied().filter(|(x, _)| x.dot(up) <= highest).collect();
        let above =
            "from above, without what is higher than all cameras; up the page is where the first photograph looks";
        let side = "from behind the first photograph";
        Ok(vec![
            PlanMap::new(above, [right, ahead, up], if below.is_empty() { &points } else { &below }, existing, planned),
            PlanMap::new(side, [right, up, -ahead], &points, existing, planned),
        ])
    }

    /// Points of surfaces that the training cameras see, with their colours.
    fn points(&self, existing: &[Camera]) -> Result<Vec<(DVec3, [u8; 3])>> {
        let n = existing.len().min(LOOKS);
        let looks: Vec<&Camera> = (0..n).map(|k| &existing[(2 * k + 1) * existing.len() / (2 * n)]).collect();
        let stride = |camera: &Camera| camera.resolution[0].max(camera.resolution[1]).div_ceil(SIDE_OF_LOOK);
        let rows = |camera: &&Camera| u64::from(camera.resolution[1].div_ceil(stride(camera)));
        self.bars.begin("rows of the map", looks.iter().map(rows).sum());
        let mut points = Vec::new();
        for camera in looks {
            let view = self.renderer.strided_image(camera, stride(camera), self.pixel_offset, &[], self.bars)?;
            let small = camera.strided(stride(camera), self.pixel_offset);
            let width = view.resolution[0] as usize;
            for (i, pixel) in view.pixels.iter().enumerate().filter(|(_, pixel)| pixel.opacity > 0.5) {
                let [x, y] = [i % width, i / width].map(|n| n as f64 + self.pixel_offset);
                points.push((small.ray(x, y).at(pixel.median_depth), bytes(pixel.color.as_vec3())));
            }
        }
        self.bars.end();
        Ok(points)
    }

    fn view(
        &self,
        next: &NextView,
        step: &Step,
        first: f64,
        name: &str,
        camera: &Camera,
        up: DVec3,
    ) -> Result<PlannedView> {
        let map = (self.gain != Gain::Coverage).then(|| next.map(camera)).transpose()?;
        let stride = camera.resolution[0].max(camera.resolution[1]).div_ceil(SIDE);
        self.bars.begin("rows of the photograph", u64::from(camera.resolution[1].div_ceil(stride)));
        let seen = self.renderer.strided_image(camera, stride, self.pixel_offset, &[], self.bars)?;
        self.bars.end();
        let nearest = self.nearest(camera);
        let near_name = printable(&nearest.name).to_string();
        let way = Way::between(&nearest.camera, camera, up).words(|v| self.unit.length(v));
        let worth = if step.gain == first {
            "It is worth most".to_owned()
        } else {
            format!("It is worth {:.0} % of the first", 100.0 * step.gain / first)
        };
        let unseen = step.unseen.map_or(String::new(), |share| {
            format!("; {:.0} % of the surface that it shows is in no photograph so far", 100.0 * share)
        });
        let lines = vec![format!("From where {near_name} was taken: {way}."), format!("{worth}{unseen}.")];
        let images = vec![
            ("what it would see".to_owned(), tinted(&seen, map.as_ref())),
            (format!("{near_name}, the nearest"), self.photograph(nearest)?),
        ];
        Ok(PlannedView { name: printable(name).to_string(), lines, images })
    }

    /// The training frame from whose place people find another best: the nearest of those that look a similar way.
    fn nearest(&self, camera: &Camera) -> &Frame {
        let distance = |frame: &Frame| frame.camera.position.distance(camera.position);
        let is_alike = |frame: &Frame| frame.camera.axes.z_axis.dot(camera.axes.z_axis) > ALIKE;
        let order = |a: &&Frame, b: &&Frame| is_alike(b).cmp(&is_alike(a)).then(distance(a).total_cmp(&distance(b)));
        self.training.iter().min_by(order).expect("a plan has training cameras")
    }

    /// A photograph from its file, or what the model shows there if it has none.
    fn photograph(&self, frame: &Frame) -> Result<RgbImage> {
        let background = self.renderer.background();
        if frame.image.is_file() {
            let longest = frame.camera.resolution[0].max(frame.camera.resolution[1]);
            let small = frame.camera.resolution.map(|n| (n * SIDE.min(longest)).div_ceil(longest));
            let image = PosedImage::of(frame)?.shrunk(small);
            let color = |x, y| Rgb(bytes(image.over((y * small[0] + x) as usize, background).as_vec3()));
            return Ok(RgbImage::from_fn(small[0], small[1], color));
        }
        let stride = frame.camera.resolution[0].max(frame.camera.resolution[1]).div_ceil(SIDE);
        let view = self.renderer.strided_image(&frame.camera, stride, self.pixel_offset, &[], self.bars)?;
        Ok(tinted(&view, None))
    }
}

/// An image, with the pixels of large gain tinted.
fn tinted(view: &RenderedView, map: Option<&GainMap>) -> RgbImage {
    let [width, height] = view.resolution;
    let gains = map.filter(|map| map.resolution == view.resolution).map_or(&[][..], |map| &map.gains);
    let mut known: Vec<f64> = gains.iter().map(|gain| f64::from(*gain)).filter(|gain| *gain > 0.0).collect();
    known.sort_unstable_by(f64::total_cmp);
    let full = if known.is_empty() { 1.0 } else { octobayes::metrics::quantile(&known, FULL) };
    RgbImage::from_fn(width, height, |x, y| {
        let i = (y * width + x) as usize;
        let share = gains.get(i).map_or(0.0, |gain| (f64::from(*gain) / full).clamp(0.0, 1.0)) as f32;
        Rgb(bytes(view.pixels[i].color.as_vec3().lerp(TINT, COVER * share)))
    })
}

fn bytes(color: Vec3) -> [u8; 3] {
    color.to_array().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8)
}

/// What a plan needs.
pub fn check_training(training: &[Frame]) -> Result<()> {
    if training.is_empty() {
        let expected = "the training cameras, beside which a plan shows its places (--cameras)";
        return Err(Error::setting("--output", expected, "none"));
    }
    Ok(())
}
