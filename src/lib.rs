//! Where can a trained radiance field be trusted?
//!
//! octobayes computes a *post-hoc spatial uncertainty* for a trained NeRF. Post-hoc: it takes the finished model
//! and its training cameras, and retrains nothing. Spatial: the result U(x) is a function of position, in scene
//! units. It measures how far each part of space could be displaced before any training image changed (Bayes' Rays:
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
//! - [`posterior`] spreads the Jacobians over the vertices around each sample, sums them along the ray, squares, and
//!   sums over rays. Sums that a budget of memory has no room for go to disk. The octree is refined where they are not
//!   negligible. Where rays cannot support the finest lattice, [`MaxLevels`](octree::MaxLevels) keep leaves coarser, if
//!   that is asked for.
//! - [`uncertainty`] computes one standard deviation per vertex from these sums and interpolates it. This is U(x), to
//!   be stored, queried, compared and merged.
//! - [`estimate`] runs all of this: an [`Estimation`](estimate::Estimation) holds the settings of a run, and a
//!   [`Plan`](estimate::Plan) bounds its time, memory and disk space by its first rays.
//!
//! The program and the Python package are made of more: `octobayes-data` reads cameras, images and arrays of other
//! programs, `octobayes-models` and `octobayes-splats` are trained models, and `octobayes-train` fits some.
//! `octobayes-evaluation` judges fields on held-out views, `octobayes-next-view` ranks cameras by how much their
//! images, not yet taken, would constrain the displacements, `octobayes-synth` makes data, `octobayes-show` draws and
//! writes for other tools, and `octobayes-session` runs from files to files.
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
//! # Versions
//!
//! Rust 1.89 or newer; that rises only with a minor version. Before 1.0 a minor version (0.1 to 0.2) may change the
//! interface and a patch version may not, by the rules that Cargo applies. Settings are built with setters, so that
//! most additions break nothing. [`glam`] is part of the interface and re-exported: its major versions are ours. Field
//! files state the version of their format, and a reader rejects unknown versions. What these pages do not show is for
//! our own crates, and may change at any time.
//!
//! # What holds
//!
//! - [`octree`] does not depend on rays or colour. Nothing here prints.
//! - The dense reference ([`posterior::DensePosterior`]) shares no accumulation code with the octree: each checks
//!   the other.
//! - Results do not depend on the number of threads, bit for bit. Rays are drawn by index and summed in ray order.
//! - Files are untrusted. Nothing is allocated by a length from a file before it is compared with the bytes
//!   present.
//! - No generic scalar. Fields compute in f32, because they are trained in it. Geometry and sums are f64, because
//!   squares between 1e-12 and 1e6 are added millions of times. Deviations are stored as f32, which moves log10 U
//!   by 3e-8.
//! - No unsafe code.

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

#[macro_use]
mod setters;
#[macro_use]
#[doc(hidden)]
pub mod choices;

pub mod error;
pub mod estimate;
pub mod field;
pub mod geometry;
#[doc(hidden)]
pub mod io;
#[doc(hidden)]
pub mod metrics;
pub mod monitor;
pub mod octree;
pub mod posterior;
pub mod rays;
pub mod render;
pub mod uncertainty;

pub use error::{Error, Result};
pub use glam;

/// The Rust of README and book is compiled and run like all documentation.
#[cfg(doctest)]
mod pages {
    #[doc = include_str!("../README.md")]
    struct Readme;
    #[doc = include_str!("../docs/src/library.md")]
    struct Library;
}
