//! Where can a trained radiance field be trusted?
//!
//! octobayes computes a *post-hoc spatial uncertainty* field for a trained NeRF: post-hoc, because it takes the finished model and
//! its training cameras and retrains nothing; spatial, because the answer is a function of position, in scene units. It asks how
//! far each part of space could be displaced without any training image noticing (Bayes' Rays: Goli, Reading, Sellán,
//! Jacobson, Tagliasacchi, CVPR 2024). Displacements live on *deformation vertices*: corners of cells, interpolated in between.
//! The paper puts them on a uniform grid; this crate puts them on an adaptive octree that is fine where images are
//! sensitive, and keeps the grid beside it as reference.
//!
//! # In the order in which data flows
//!
//! A [`field`] returns density and colour for a position and a direction, nothing else is asked of it. [`render`] samples a
//! training ray, composites it, and differentiates its pixel with respect to the positions of its samples, with central
//! differences of the field. [`posterior`] spreads these Jacobians onto the vertices around each sample, sums them over the
//! ray, squares, and sums over rays. [`octree`] is refined where that left a trace. [`uncertainty`] reads one number per vertex off the
//! sums and interpolates it; fields are stored, queried, compared. [`evaluate`] asks whether it ranks the depth error, by [`metrics`], beside measures that need no Hessian; [`synth`]
//! makes data whose depth is known exactly, and [`train`] a field of such data or any other posed images.
//!
//! Where rays or memory cannot support the finest lattice, [`octree::MaxLevels`] keep leaves coarser, and [`estimate::Planner`] says
//! beforehand what that gives up. [`geometry::Domain`] is the space that a field covers: a box, or all of space, contracted.
//!
//! ```
//! use glam::Vec3;
//! use octobayes::estimate::{Estimation, GridSettings, RaySettings};
//! use octobayes::field::ClosedForm;
//!
//! // A courtyard that four cameras look at from one side.
//! let scene = ClosedForm::courtyard();
//! let cameras = ClosedForm::half_circle(4, [48, 48]);
//! let rays = RaySettings { rays: 16_000, occupancy: 48, ..RaySettings::default() };
//! let grid = GridSettings { level: 6, ..GridSettings::default() };
//! let outcome = Estimation::new(&scene, &cameras).rays(rays).grid(grid).run()?;
//! let uncertainty = outcome.field;
//! assert_eq!(outcome.progress.rays, 16_000);
//!
//! // The blue ball's front was seen; its back was not, and keeps the prior: "never seen".
//! let front = uncertainty.query(Vec3::new(0.75, -0.5, -0.35)).uncertainty;
//! let back = uncertainty.query(Vec3::new(0.3, -0.5, -0.4)).uncertainty;
//! assert!(front < 0.1 * back);
//! assert!(back > 0.9 * uncertainty.prior());
//! # Ok::<(), octobayes::Error>(())
//! ```
//!
//! The primary types are [`field::RadianceField`] (implement it for your own model), [`estimate::Estimation`] (what to compute), and [`uncertainty::UncertaintyField`] (the result). Jacobians from elsewhere,
//! autograd on a GPU say, go through [`estimate::FieldBuilder`] as [`render::RaySamples`].
//!
//! # What holds
//!
//! - [`octree`] knows nothing of rays or colour; only [`field`] knows how a model is stored; only [`cli`] prints.
//! - The dense reference ([`posterior::DensePosterior`]) shares no accumulation code with the octree: each checks the other.
//! - Results do not depend on the number of threads, bit for bit: rays are drawn by index and summed in ray order.
//! - A file read is untrusted: nothing is allocated by a length that has not been compared with the bytes that are there.
//! - No generic scalar: fields speak f32, because they are trained in it; geometry and sums are f64, because squares between
//!   1e-12 and 1e6 are added millions of times; deviations are stored as f32, which moves log10 U by 3e-8
//!   (or as 16-bit logarithms, by a stated amount).
//! - No unsafe code.

// Some of what the command line and the trainer alone use is compiled without them: better than a feature gate at every function.
#![cfg_attr(not(feature = "cli"), allow(dead_code, unused_imports))]

#[cfg(feature = "cli")]
mod cli;
pub mod dataset;
pub mod error;
pub mod estimate;
pub mod evaluate;
pub mod field;
pub mod geometry;
mod io;
pub mod metrics;
pub mod monitor;
pub mod octree;
pub mod open;
#[cfg(feature = "cli")]
mod picture;
pub mod posterior;
pub mod rays;
pub mod render;
#[cfg(feature = "synth")]
pub mod synth;
#[cfg(feature = "train")]
pub mod train;
pub mod uncertainty;
pub mod zoo;

pub use error::{Error, Result};
pub use glam;

/// Not part of the library: what its own command line, tests, benches and experiments need of it.
#[doc(hidden)]
pub mod internal {
    #[cfg(feature = "cli")]
    pub use crate::cli::main;
    pub use crate::io::{AtomicFile, memory, npy, npz};
    #[cfg(feature = "cli")]
    pub use crate::picture::*;
}
