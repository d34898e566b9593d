//! The model that is judged, ready for images.

use crate::Result;
use crate::estimate::{RaySettings, Subject};
use crate::geometry::{Aabb, Domain, Lattice};
use crate::monitor::Monitor;
use crate::render::{Pixel, RenderedView, Renderer, Tracer, VolumeRenderer};
use crate::splats::{SplatRenderer, Splats};
use crate::uncertainty::{Answers, ThresholdedField, is_certain};

use super::TrueView;

/// A model as images show it: a volume or splats.
#[derive(Clone)]
pub enum ShownModel<'a> {
    /// Density and colour at points.
    Volume(Box<VolumeRenderer<'a>>),
    /// Gaussian splats.
    Splats(SplatRenderer<'a>),
}

impl<'a> ShownModel<'a> {
    /// The model in front of the background of `settings`. Of a volume, depths have deviations if `lattice` is there:
    /// that of the field, by which the model is differentiated.
    ///
    /// # Errors
    /// As [`RaySettings::tracer`] and [`RaySettings::differentiation`].
    pub fn new(
        model: Subject<'a>,
        settings: &RaySettings,
        lattice: Option<&Lattice>,
        monitor: &dyn Monitor,
    ) -> Result<Self> {
        Ok(match model {
            Subject::Volume(field) => {
                let tracer = settings.tracer(field, 0.0, monitor)?;
                let differentiation = lattice.map(|lattice| settings.differentiation(field, lattice)).transpose()?;
                Self::Volume(Box::new(VolumeRenderer { tracer, differentiation }))
            }
            Subject::Splats(splats) => Self::Splats(SplatRenderer::new(splats, settings.background)),
        })
    }

    /// What renders it.
    #[must_use]
    pub fn renderer(&self) -> &dyn Renderer {
        match self {
            Self::Volume(volume) => volume.as_ref(),
            Self::Splats(splats) => splats,
        }
    }

    /// Calls `job` with what renders the part of the model at which log10 U is at most `threshold`; with `None` if
    /// nothing is left.
    ///
    /// # Errors
    /// Those of `job`, and if the uncertainty cannot be read.
    pub fn with_certain_part<T>(
        &self,
        uncertainty: &dyn Answers,
        threshold: f64,
        job: impl FnOnce(Option<&dyn Renderer>) -> Result<T>,
    ) -> Result<T> {
        match self {
            Self::Volume(volume) => {
                let tracer = &volume.tracer;
                let field = ThresholdedField::new(tracer.field, uncertainty, threshold);
                // The samples stay the same: removing density keeps every upper bound of it valid.
                let tracer = Tracer { field: &field, ..tracer.clone() };
                let done = job(Some(&VolumeRenderer { tracer, differentiation: None }))?;
                field.check().map(|()| done)
            }
            Self::Splats(whole) => {
                let kept = is_certain(whole.splats(), uncertainty, threshold)?;
                if !kept.contains(&true) {
                    return job(None);
                }
                let left = Splats::clone(whole.splats()).keep(&kept)?;
                job(Some(&SplatRenderer::new(&left, whole.background())))
            }
        }
    }
}

/// What a view shows of nothing.
pub(super) fn empty_view(truth: &TrueView, renderer: &dyn Renderer) -> RenderedView {
    let nothing = Pixel { color: renderer.background(), ..Pixel::default() };
    let pixels = vec![nothing; truth.colors.len()];
    RenderedView { resolution: truth.camera.resolution, pixels, ..RenderedView::default() }
}

/// The box beyond which a depth is none of the model's: the volume's, or that of nearly all splats, as strays lie
/// anywhere.
pub(super) fn bounds_of(model: Subject) -> Aabb {
    match model {
        Subject::Volume(field) => field.bounds(),
        Subject::Splats(splats) => splats.main_box(),
    }
}

/// The length to which errors of depth are compared, scene units.
pub(super) fn size_of(model: Subject) -> f64 {
    match model {
        Subject::Volume(field) => match field.natural_domain() {
            Domain::Box(bounds) => bounds.longest_edge(),
            Domain::Contracted { radius, .. } => 2.0 * radius,
        },
        Subject::Splats(splats) => splats.main_box().longest_edge(),
    }
}
