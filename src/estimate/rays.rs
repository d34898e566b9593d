//! Settings of rays: which are drawn, and how they are sampled and differentiated.

use glam::{DVec3, Vec3};

use super::{Feature, Model, PositionCheck, require};
use crate::field::RadianceField;
use crate::geometry::{Aabb, Camera, Domain, Lattice};
use crate::monitor::Monitor;
use crate::rays::{MOST_SAMPLES, PixelSequence, Pixels, RayStream};
use crate::render::{
    Differences, Differentiation, GradientMethod, LONGEST_STEP, Marcher, Occupancy, Stencil, Tracer, VolumeRenderer,
};
use crate::{Error, Result};

/// Finite-difference step in lattice edges, unless f32 positions need more.
///
/// A forward difference is as far from its place as it is wide, so it is narrower (`experiments/speed_vs_error.md`).
fn default_step(stencil: Stencil) -> f64 {
    match stencil {
        Stencil::Central => 1.0 / 512.0,
        Stencil::Forward => 1.0 / 2048.0,
    }
}
/// Shortest step that f32 positions allow, in multiples of their spacing.
///
/// x ± h is then rounded by less than an eighth of h, and differences are divided by the rounded distance.
const MIN_STEP_SPACINGS: f64 = 4.0;

/// Maximal number of samples along a ray; hundreds of rays are in progress at once.
const MAX_STEPS: f64 = MOST_SAMPLES as f64;

setters! {
    /// Settings of rays: which are drawn, and how they are sampled and differentiated.
    #[derive(Debug, Clone, Copy, PartialEq)]
    #[non_exhaustive]
    pub struct RaySettings {
        /// R, the number of rays. [`Pixels::Every`] replaces it by the number of pixels that masks keep.
        pub rays: u64,
        /// The method of choosing pixels.
        pub pixels: Pixels,
        /// Seed of pixels and jitter.
        pub seed: u64,
        /// Source of the field's derivatives.
        pub gradient: GradientMethod,
        /// Finite-difference step in edges of the finest lattice. `None` for 1/512, for 1/2048 with forward
        /// differences, or for what f32 positions need on very fine lattices.
        ///
        /// Larger steps smooth the field's derivative and change log10 U; smaller ones are dominated by f32 rounding.
        /// The curves in `experiments/hard_cases.md` compare with exact derivatives at level 8. For the two trained
        /// models, the mean |Δ log10 U| is lowest (0.006, 0.004) around 1/1024 and grows to 0.03 at 1/128, because of
        /// kinks and high frequencies. Smooth fields would prefer 1/16 and lose 6e-5 at 1/512. On much finer lattices
        /// rounding matters more; [`super::StepCheck`] measures both.
        pub step: Option<f64> as into,
        /// Samples are not differentiated if their weight stays below this, and so does their sensitivity, as
        /// estimated from density bounds and neighbours. Rays end at this transmittance.
        ///
        /// The cutoff bounds what a pixel loses rather than the change of log10 U, and is not part of the
        /// tolerance. `experiments/approximations.md` has its cost, and [`super::Audit`] measures it. 0 leaves out
        /// nothing and takes a hundred times longer.
        pub cutoff: f64,
        /// Distance between samples, scene units; `None` for the field's suggestion.
        pub march_step: Option<f64> as into,
        /// Colour behind the scene.
        pub background: Vec3,
        /// Position of rays within their pixel; `None` for the field's own.
        pub pixel_offset: Option<f64> as into,
        /// Cells per axis of the occupancy grid.
        pub occupancy: usize,
    }
}

impl Default for RaySettings {
    fn default() -> Self {
        Self {
            rays: 4_096_000,
            pixels: Pixels::default(),
            seed: 0,
            gradient: GradientMethod::default(),
            step: None,
            cutoff: 1e-6,
            march_step: None,
            background: Vec3::ONE,
            pixel_offset: None,
            occupancy: Occupancy::DEFAULT_RESOLUTION,
        }
    }
}

impl RaySettings {
    /// A tracer through `field`, whose occupancy grid is valid within the distance `reach`, scene units.
    ///
    /// # Errors
    /// If the step is too small or too large for the field's box, a number makes no sense, or [`Error::Interrupted`].
    #[doc(hidden)]
    pub fn tracer<'a>(&self, field: &'a dyn RadianceField, reach: f64, monitor: &dyn Monitor) -> Result<Tracer<'a>> {
        let shares = [("pixel offset", self.pixel_offset.unwrap_or(0.0)), ("cutoff", self.cutoff)];
        if let Some((what, value)) = shares.into_iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return Err(Error::setting(what, "a number from 0 to 1", format!("{value:e}")));
        }
        let occupancy =
            if self.cutoff > 0.0 { Some(Occupancy::build(field, self.occupancy, reach, monitor)?) } else { None };
        let step = self.march_step.unwrap_or_else(|| field.suggested_step());
        let steps = field.bounds().size().length() / step;
        if !(1.0..=MAX_STEPS).contains(&steps) {
            let expected = match steps {
                // Samples further apart than the box is wide see nothing of what is in it.
                ..1.0 => "at least one step across the field's box".into(),
                _ => format!("at most {MAX_STEPS} steps across the field's box"),
            };
            return Err(Error::setting("march step", expected, format!("{step:e} scene units, {steps:.0} steps")));
        }
        let marcher = Marcher { step, bounds: field.bounds(), occupancy, cutoff: self.cutoff };
        Ok(Tracer { field, marcher, background: self.background })
    }

    /// Settings for images. What the cutoff leaves out in front and behind changes a pixel by no more than 1e-4, less
    /// than half a step of 8 bits. Derivatives are the field's own, if it has any.
    #[must_use]
    pub fn for_images() -> Self {
        Self { cutoff: 1e-4, gradient: GradientMethod::Auto, ..Self::default() }
    }

    /// Position in a pixel that its ray passes through, 0 to 1 along x and y: the model's own, if none is set.
    #[must_use]
    pub fn offset_for(&self, model: &dyn Model) -> f64 {
        self.pixel_offset.unwrap_or_else(|| model.pixel_offset())
    }

    /// The stream of rays from `cameras` through `model`, differentiated for `lattice`.
    ///
    /// # Errors
    /// If a setting does not apply to the model or is out of range, if the model cannot render a camera or does not
    /// provide the requested derivatives, if the spacing of f32 positions exceeds the finite-difference step, or
    /// [`Error::Interrupted`].
    pub fn stream<'a>(
        &self,
        model: &'a dyn Model,
        cameras: &'a [Camera],
        lattice: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<RayStream<'a>> {
        self.check_for(model)?;
        let pixel_offset = self.offset_for(model);
        if !(0.0..=1.0).contains(&pixel_offset) {
            return Err(Error::setting("pixel offset", "a number from 0 to 1", format!("{pixel_offset:e}")));
        }
        let source = model.for_rays(self, lattice, monitor)?;
        cameras.iter().try_for_each(|camera| model.check_camera(camera))?;
        Ok(RayStream {
            source,
            cameras,
            pixel_offset,
            pixels: PixelSequence::new(self.pixels, self.seed, cameras.iter().map(|c| c.resolution).collect()),
        })
    }

    /// Refuses settings of a march for a model that is not marched, and pixels that cannot be drawn camera by camera.
    fn check_for(&self, model: &dyn Model) -> Result<()> {
        let defaults = Self::default();
        // `auto` chooses own derivatives, and such a model has no others.
        let is_open = self.gradient == defaults.gradient || self.gradient == GradientMethod::Auto;
        for (what, is_set, feature) in [
            ("march step", self.march_step.is_some(), Feature::March),
            ("finite-difference step", self.step.is_some(), Feature::March),
            ("gradient", !is_open, Feature::March),
            ("cutoff", self.cutoff != defaults.cutoff, Feature::March),
            ("occupancy", self.occupancy != defaults.occupancy, Feature::March),
            ("pixels", self.pixels == Pixels::Random, Feature::AnyOrder),
        ] {
            if is_set {
                require(model, feature, what)?;
            }
        }
        Ok(())
    }

    /// `field` as training rays see it, differentiated for `lattice`.
    ///
    /// # Errors
    /// As [`RaySettings::stream`].
    #[doc(hidden)]
    pub fn volume<'a>(
        &self,
        field: &'a dyn RadianceField,
        lattice: &Lattice,
        monitor: &dyn Monitor,
    ) -> Result<VolumeRenderer<'a>> {
        let differentiation = self.differentiation(field, lattice)?;
        // h is largest at the corner of the field's box that is farthest from the contraction's centre.
        let bounds = field.bounds();
        let corner = |c: u8| {
            DVec3::from(std::array::from_fn(|axis| [bounds.min(), bounds.max()][usize::from(c >> axis & 1)][axis]))
        };
        let differences = &differentiation.differences;
        let farthest = (0..8).map(|c| differences.reach(corner(c).as_vec3())).fold(DVec3::ZERO, DVec3::max);
        let tracer = self.tracer(field, farthest.max_element(), monitor)?;
        Ok(VolumeRenderer { tracer, differentiation: Some(differentiation) })
    }
}

impl RaySettings {
    /// How `field` is differentiated for `lattice`.
    ///
    /// # Errors
    /// If the field does not provide the requested derivatives, if the finite-difference step is longer than an edge,
    /// or stands beside derivatives of the field's own, or if the spacing of f32 positions exceeds the step or, without
    /// one, an edge of the lattice.
    pub(super) fn differentiation<'a>(
        &self,
        field: &'a dyn RadianceField,
        lattice: &Lattice,
    ) -> Result<Differentiation<'a>> {
        if let Some(step) = self.step.filter(|&step| !(step > 0.0 && step <= 1.0)) {
            // A longer step reaches over the neighbouring vertices: it is no derivative of this one's displacement.
            let expected = "above 0, and at most one edge of the finest lattice";
            return Err(Error::setting("finite-difference step", expected, format!("{step:e} edges")));
        }
        let differences = self.differences(lattice, &field.bounds());
        let analytic = self.gradient.of(field)?;
        if let (Some(_), Some(step)) = (analytic, self.step) {
            let expected = "none: the derivatives are the model's own (--gradient finite-difference takes a step)";
            return Err(Error::setting("finite-difference step", expected, format!("{step:e} edges")));
        }
        match analytic {
            None => check_resolution(&differences, &field.bounds())?,
            Some(_) => check_positions(lattice, &field.bounds())?,
        }
        Ok(Differentiation { differences, analytic })
    }

    /// The finite-difference steps for a lattice, over the box of a field.
    pub(super) fn differences(&self, lattice: &Lattice, bounds: &Aabb) -> Differences {
        let (edge, domain, stencil) = (lattice.edge(), *lattice.domain(), Stencil::of(self.gradient));
        let step = match self.step {
            Some(step) => step * edge,
            None => DVec3::from(std::array::from_fn(|axis| {
                let (_, apart) = resolution(&domain, bounds, axis);
                let (step, least) = (default_step(stencil) * edge[axis], MIN_STEP_SPACINGS * apart);
                if least <= LONGEST_STEP * edge[axis] { step.max(least) } else { step }
            })),
        };
        Differences { step, domain, stencil }
    }
}

/// The shortest step that f32 positions allow everywhere in a box, lattice edges.
pub(super) fn shortest_step(lattice: &Lattice, bounds: &Aabb) -> f64 {
    let edges =
        (0..3).map(|axis| MIN_STEP_SPACINGS * resolution(lattice.domain(), bounds, axis).1 / lattice.edge()[axis]);
    edges.fold(0.0, f64::max)
}

/// The coordinate of a box that is farthest from the origin, of those that a domain holds finely, and the spacing of
/// f32 numbers there.
pub(super) fn resolution(domain: &Domain, bounds: &Aabb, axis: usize) -> (f32, f64) {
    // Outside a contraction's ball h grows faster than the spacing of positions, so the worst place is in the ball.
    // What lies outside a box adds nothing to its field.
    let (low, high) = match domain {
        Domain::Box(inner) => (inner.min()[axis], inner.max()[axis]),
        Domain::Contracted { center, radius, .. } => (center[axis] - radius, center[axis] + radius),
    };
    let [low, high] = [low, high].map(|x| x.clamp(bounds.min()[axis], bounds.max()[axis]));
    let farthest = low.abs().max(high.abs()) as f32;
    (farthest, f64::from(farthest.next_up()) - f64::from(farthest))
}

/// Rejects steps below the spacing of f32 positions: x ± h would equal x, every derivative would be 0, and U the prior.
fn check_resolution(differences: &Differences, bounds: &Aabb) -> Result<()> {
    for axis in 0..3 {
        let ((farthest, apart), h) = (resolution(&differences.domain, bounds, axis), differences.step[axis]);
        if h < apart {
            let expected = format!(
                "at least {apart:e} scene units, what f32 positions are apart at {farthest:e}, or a \
                 scene nearer to the origin"
            );
            return Err(Error::setting("finite-difference step", expected, format!("{h:e}")));
        }
    }
    Ok(())
}

/// Rejects lattices whose edges are below the spacing of f32 positions: samples would miss the cells that they are in.
fn check_positions(lattice: &Lattice, bounds: &Aabb) -> Result<()> {
    let PositionCheck { farthest, apart, edges, .. } = PositionCheck::of_box(lattice, bounds);
    if edges < 1.0 {
        return Ok(());
    }
    let expected = format!(
        "at least {apart:e} scene units, what f32 positions are apart at {farthest:e}, or a scene \
                            nearer to the origin"
    );
    Err(Error::setting("cells of the finest level", expected, format!("{:e}", apart / edges)))
}
