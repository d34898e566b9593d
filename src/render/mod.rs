//! Rays through a field: samples, compositing, and the Jacobian of a pixel with respect to its samples.

mod composite;
mod depth;
mod gradient;
mod images;
mod jacobian;
mod march;
mod noise;
mod occupancy;
mod ray_average;
mod samples;
mod shade;
mod trace;
mod view;

pub use composite::Pixel;
pub use depth::{DepthProbe, DepthSample, DepthVariance};
pub use gradient::{Differences, Differentiation, GradientMethod, Stencil};
pub use images::{Renderer, VolumeRenderer};
pub use march::Marcher;
pub(crate) use march::SampleDistances;
pub(crate) use noise::LONGEST_STEP;
pub use noise::{DifferenceError, DifferenceErrors};
pub use occupancy::Occupancy;
pub use ray_average::RayAverage;
pub use samples::{RaySample, RaySamples, VisibleSegment};
pub(crate) use trace::TracedRays;
pub use trace::Tracer;
pub use view::{
    MIN_SUPPORTING_RAYS, Probe, Probed, ProbedField, RenderedView, render_rays, render_view, render_view_with_depth,
};
pub(crate) use view::{WeightedRays, check_size};

// The steps of a tracer, for this crate's experiments and tests.
#[doc(hidden)]
pub use composite::{CompositingWeights, depth_variance, termination_entropy};
#[doc(hidden)]
pub use jacobian::{JacobianBuffers, RayBatch};
#[doc(hidden)]
pub use trace::TraceBuffers;
