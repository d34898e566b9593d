//! Rays through a field: samples, compositing, and the Jacobian of a pixel with respect to its samples.

mod composite;
mod jacobian;
mod march;
mod occupancy;
mod trace;
mod view;

pub use composite::{Pixel, Quadrature};
pub use jacobian::{Differences, RaySample, RaySamples};
pub use march::{Marcher, Walk};
pub use occupancy::Occupancy;
pub use trace::{TracedRays, Tracer};
pub use view::{Blend, Probe, RenderedView, render_view};
