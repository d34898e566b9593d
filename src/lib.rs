//! Where can a trained radiance field be trusted?
//!
//! octobayes computes a *post-hoc spatial uncertainty* for a trained NeRF. Post-hoc: it takes the finished model
//! and its training cameras, and retrains nothing. Spatial: the answer U(x) is a function of position, in scene
//! units. It says how far each part of space could be displaced without any training image noticing (Bayes' Rays:
//! Goli, Reading, Sellán, Jacobson, Tagliasacchi, CVPR 2024).
//!
//! Displacements live on *deformation vertices*, the corners of cells, and are interpolated in between. The paper
//! puts these vertices on a uniform grid. This crate puts them on an adaptive octree that is fine where images are
//! sensitive, and keeps the grid beside it as reference.
//!
//! # In the order in which data flows
//!
//! - [`geometry`] has cameras, rays, the lattice, and the [`Domain`](geometry::Domain) that a result covers: a
//!   box, or all of space, contracted.
//! - [`octree`] has cells of many sizes, and the deformation vertices at their corners.
//! - [`field`] is the model: a [`RadianceField`](field::RadianceField) returns density and colour for positions
//!   and directions.
//! - [`render`] samples a ray through the field, composites its pixel, and differentiates the pixel with respect
//!   to the positions of the samples: by central differences, or by the field's own derivatives.
//! - [`rays`] draws the training rays and hands on their samples with these Jacobians.
//! - [`posterior`] spreads the Jacobians over the vertices around each sample, sums them along the ray, squares,
//!   and sums over rays. It refines the octree where rays left a trace. Where rays or memory cannot support the
//!   finest lattice, [`MaxLevels`](octree::MaxLevels) keep leaves coarser.
//! - [`uncertainty`] reads one standard deviation per vertex off these sums and interpolates it. This is U(x), to
//!   be stored, queried, compared and merged.
//! - [`estimate`] runs all of this: an [`Estimation`](estimate::Estimation) holds the settings of a run, and a
//!   [`Planner`](estimate::Planner) tells beforehand what it needs.
//! - [`evaluate`] checks whether U ranks the depth error of held-out views, beside measures that need no Hessian.
//! - [`metrics`] has the formulas for that, and those of image quality.
//!
//! Input comes from these:
//!
//! - [`dataset`] reads posed images, their split, and depth maps.
//! - [`zoo`] has scenes that are hard, each in one way, with the result to expect.
//! - [`train`] fits a hash grid to posed images.
//! - [`synth`] ray-traces a mesh into images whose depth is known exactly.
//! - [`open`] finds the model that a name means: a file or a built-in scene.
//!
//! # Example
//!
//! ```
//! use glam::Vec3;
//! use octobayes::estimate::{Estimation, GridSettings, RaySettings};
//! use octobayes::field::ClosedForm;
//!
//! // A courtyard that four cameras look at from one side.
//! let scene = ClosedForm::courtyard();
//! let cameras = ClosedForm::half_circle(4, [48, 48]);
//! let rays = RaySettings::default().rays(16_000).occupancy(48);
//! let grid = GridSettings::default().level(6);
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
//! The primary types are [`field::RadianceField`] (implement it for your own model), [`estimate::Estimation`]
//! (what to compute), and [`uncertainty::UncertaintyField`] (the result). Jacobians from elsewhere, such as
//! autograd on a GPU, go through [`estimate::FieldBuilder`] as [`render::RaySamples`].
//!
//! # What holds
//!
//! - [`octree`] knows nothing of rays or colour. Only [`field`] knows how a model is stored. Only the command line
//!   prints.
//! - The dense reference ([`posterior::DensePosterior`]) shares no accumulation code with the octree: each checks
//!   the other.
//! - Results do not depend on the number of threads, bit for bit. Rays are drawn by index and summed in ray order.
//! - Files are untrusted. Nothing is allocated by a length from a file before it is compared with the bytes
//!   present.
//! - No generic scalar. Fields speak f32, because they are trained in it. Geometry and sums are f64, because
//!   squares between 1e-12 and 1e6 are added millions of times. Deviations are stored as f32, which moves log10 U
//!   by 3e-8 (or as 16-bit logarithms, by a stated amount).
//! - No unsafe code.

// Without the `cli` feature, code that only the command line or the trainer uses may be dead. Allowing that here is
// better than a gate at every function.
#![cfg_attr(not(feature = "cli"), allow(dead_code, unused_imports))]
// Both macros panic if the stream cannot be written: `say!` and `announce!` of the command line do not.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

#[cfg(feature = "cli")]
mod cli;
pub mod dataset;
pub mod error;
pub mod estimate;
pub mod evaluate;
#[cfg(feature = "export")]
pub mod export;
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
#[cfg(feature = "cli")]
mod viewer;
pub mod zoo;

pub use error::{Error, Result};
pub use glam;

/// Not part of the public API: what the crate's own command line, tests, benches and experiments need.
#[doc(hidden)]
pub mod internal {
    #[cfg(feature = "cli")]
    pub use crate::cli::main;
    #[cfg(feature = "synth")]
    pub use crate::io::write_exr;
    pub use crate::io::{AtomicFile, memory, npy, npz};
    #[cfg(feature = "cli")]
    pub use crate::picture::*;
    #[cfg(feature = "train")]
    pub use crate::train::pixel_gradient::{OUTPUTS as PIXEL_OUTPUTS, PixelGradient, PixelGradients};
}

/// The Rust of README and book is compiled and run like all documentation.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../README.md")]
    struct Readme;
    #[doc = include_str!("../docs/src/library.md")]
    struct Library;
}
