//! Rays through a field: samples, compositing, and the Jacobian of a pixel with respect to its samples.

mod choose;
mod composite;
mod depth;
mod gradient;
mod jacobian;
mod march;
mod noise;
mod occupancy;
mod question;
mod ray_average;
mod samples;
mod shade;
mod together;
mod trace;
mod view;

pub use composite::{CompositingWeights, Pixel, depth_variance, termination_entropy};
pub use depth::{DepthProbe, DepthSample, DepthVariance};
pub use gradient::{Differences, Differentiation, GradientMethod, Stencil};
pub use jacobian::JacobianBuffers;
pub use march::{Marcher, SampleDistances};
pub use noise::{DifferenceError, DifferenceErrors, LONGEST_STEP, TABLE, noise_level};
pub use occupancy::Occupancy;
pub use ray_average::RayAverage;
pub use samples::{RaySample, RaySamples, VisibleSegment};
pub use together::{RayGroup, RaysTogether};
pub use trace::{TraceBuffers, TracedRays, Tracer};
pub use view::{FEWEST, Probe, Probed, ProbedField, RenderedView, render_rays, render_view, render_view_with_depth};

use question::{Kind, Question};
