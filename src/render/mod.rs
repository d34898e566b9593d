//! Rays through a field: samples, compositing, and the Jacobian of a pixel with respect to its samples.

mod composite;
mod gradient;
mod jacobian;
mod march;
mod noise;
mod occupancy;
mod probe;
mod ray_average;
mod renderer;
mod samples;
mod shade;
mod trace;
mod view;
mod volume;

pub use composite::Pixel;
pub use gradient::{Differentiation, GradientMethod};
pub(crate) use march::SampleDistances;
pub use noise::DifferenceErrors;
pub(crate) use noise::LONGEST_STEP;
pub use probe::{MIN_SUPPORTING_RAYS, Probe, Probed, ProbedField};
pub use ray_average::RayAverage;
pub use renderer::{CameraView, ImagePoints, Outputs, Renderer, WeightedSamples};
pub use samples::{RaySample, RaySamples, VisibleSegment};
pub use view::RenderedView;
pub(crate) use volume::INSIDE_MATTER_SAMPLES;
pub use volume::VolumeRenderer;

// What only the program, Python and the experiments name.
#[doc(hidden)]
pub use self::{
    composite::{CompositingWeights, depth_variance},
    gradient::{Differences, Stencil},
    jacobian::{JacobianBuffers, RayBatch},
    march::Marcher,
    noise::DifferenceError,
    occupancy::Occupancy,
    trace::{TraceBuffers, Tracer},
    view::{WeightedRays, check_size, render_rays, render_view},
};
