//! A model with its uncertainty, ready for pictures.

use crate::panels::{Ranges, depth_range, error_range, view_panels};
use crate::progress::Bars;
use octobayes::Result;
use octobayes::geometry::Camera;
use octobayes::render::{Probe, RayAverage, RenderedView, Renderer};
use octobayes::uncertainty::{BakedField, UncertaintyField, shown_log10, unknowns};
use octobayes_depth::{DepthDeviation, TrainingViews};
use octobayes_show::picture::Panel;

/// What pictures are made of.
pub struct Studio<'a> {
    /// The uncertainty.
    pub field: &'a UncertaintyField,
    /// The same, for answers at the points of pictures.
    pub baked: &'a BakedField<'a>,
    /// The model.
    pub whole: &'a dyn Renderer,
    /// The model without what is uncertain.
    pub cleaned: Option<Cleaned<'a>>,
    /// Where in a pixel rays pass.
    pub offset: f64,
    /// How log10 U is averaged along a ray.
    pub average: RayAverage,
    /// Whether depth gets its standard deviation.
    pub depth_error: bool,
    /// What the model's training cameras see of it, if that stands beside the deviation.
    pub training: Option<TrainingViews>,
    /// Ends of the colour bar of log10 U.
    pub log10: [f64; 2],
    /// Progress, one unit a row of pixels.
    pub bars: &'a Bars,
}

/// A picture of a model.
#[derive(Clone, Default)]
pub struct StudioView {
    /// Colour, depth and U.
    pub rendered: RenderedView,
    /// `[height · width]`: standard deviation of depth, if that is wanted, scene units; NaN where nothing is shown.
    pub deviation: Option<Vec<f64>>,
}

/// A model without what is uncertain.
#[derive(Clone, Copy)]
pub struct Cleaned<'a> {
    /// What is left.
    pub left: &'a dyn Renderer,
    /// The largest log10 U that is left.
    pub threshold: f64,
}

impl Studio<'_> {
    fn view(&self, renderer: &dyn Renderer, camera: &Camera) -> Result<StudioView> {
        let probes = [Probe { field: self.baked, averages: &[self.average] }];
        let rendered = renderer.image(camera, self.offset, &probes, self.bars)?;
        let of_field = || {
            let deviation = DepthDeviation::new(self.baked, None)?;
            deviation.of_view(renderer, camera, self.offset, &rendered, self.bars)
        };
        let deviation = self.depth_error.then(of_field).transpose()?;
        Ok(StudioView { rendered, deviation })
    }

    /// The view of a camera without what is uncertain, if that is wanted.
    pub fn cleaned_view(&self, camera: &Camera) -> Result<Option<StudioView>> {
        self.cleaned.map(|cleaned| self.view(cleaned.left, camera)).transpose()
    }

    /// The view of a camera.
    pub fn whole_view(&self, camera: &Camera) -> Result<StudioView> {
        self.view(self.whole, camera)
    }

    /// The views of a camera: the model, and the model cleaned.
    pub fn views(&self, camera: &Camera) -> Result<(StudioView, Option<StudioView>)> {
        let cleaned = self.cleaned_view(camera)?;
        Ok((self.whole_view(camera)?, cleaned))
    }

    /// log10 U as pictures show it, `[height · width]`: NaN where there is no value.
    pub fn shown_log10(&self, camera: &Camera, view: &RenderedView) -> Vec<f64> {
        let unknowns = unknowns(self.baked, camera, self.offset, view);
        shown_log10(view, &view.log10_uncertainty[0], &unknowns)
    }

    /// Whether training cameras confirm the depth of each pixel, `[height · width]`; `None` if that is not requested.
    pub fn confirmed(&self, camera: &Camera, view: &RenderedView) -> Option<Vec<bool>> {
        self.training.as_ref().map(|training| training.confirmed(camera, self.offset, view))
    }

    /// Labelled panels of both, one row each.
    pub fn rows(
        &self,
        name: &str,
        camera: &Camera,
        (view, cleaned): &(StudioView, Option<StudioView>),
    ) -> Vec<Vec<Panel>> {
        let both = || [view].into_iter().chain(cleaned);
        let ranges = Ranges {
            depth: depth_range(both().map(|view| &view.rendered)),
            error: error_range(both().filter_map(|view| Some((&view.rendered, view.deviation.as_ref()?)))),
            conformal: self.field.conformal().copied(),
            log10: self.log10,
            prior: self.field.prior().log10(),
            quantity: self.field.record().scale.quantity(),
        };
        let panels = |name: &str, StudioView { rendered, deviation }: &StudioView| {
            let unknown = unknowns(self.baked, camera, self.offset, rendered);
            view_panels(rendered, deviation.as_deref(), name, ranges, &unknown)
        };
        let mut rows = vec![panels(name, view)];
        if let (Some(cleaned), Some(Cleaned { threshold, .. })) = (cleaned, self.cleaned) {
            rows.push(panels(&format!("log10 U ≤ {threshold:.3}"), cleaned));
        }
        rows
    }
}
