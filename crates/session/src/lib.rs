//! A run as a user asks for it: from a model, its cameras and settings to a field in a file.
//!
//! [`OpenedModel`] and [`CameraSource`] find the inputs and name them by their content. A [`Session`] holds what is
//! asked for. [`Session::prepare`] checks everything that can be checked before the first ray, [`Prepared::finish`]
//! draws the rays and attaches what belongs to the result, [`Finished::save`] writes it. [`Accumulation`] does the same
//! for samples from elsewhere.
//!
//! What a user should know arrives as a [`Message`](octobayes::monitor::Message) at `tell`, in the order in which it is
//! found. Options have the names of the command line, which [`in_flags`] gives to the library's own errors as well;
//! Python rewrites them into arguments. The command line and Python are two faces of this crate.
//!
//! # Example
//! ```
//! use octobayes_session::OpenedModel;
//!
//! let opened = OpenedModel::open("scene:courtyard", None, None)?;
//! assert_eq!(opened.model.kind(), "a volume");
//! // A file is named by its content, too.
//! assert!(OpenedModel::open("missing.ply", None, None).is_err());
//! # Ok::<(), octobayes::Error>(())
//! ```

// Both macros panic if the stream cannot be written.
#![cfg_attr(not(test), warn(clippy::print_stderr, clippy::print_stdout))]

mod accumulation;
mod belongs;
mod cameras;
mod candidates;
mod checks;
mod flags;
mod identity;
pub mod memory;
mod model;
mod needs;
mod purpose;
mod report;
mod run;
mod scale;
mod survey;
mod threshold;
mod training_args;
mod world;

pub use accumulation::Accumulation;
pub use belongs::{check_fields, image_settings};
pub use cameras::scaled;
pub use cameras::{CameraSource, Resolution, TrainingCameras};
pub use candidates::Candidates;
pub use flags::in_flags;
pub use model::OpenedModel;
pub use needs::Needs;
pub use needs::given_up;
pub use purpose::{Choices, Purpose};
pub use report::PERCENTS;
pub use report::{Finished, described};
pub use run::{CheckedViews, Prepared, Session};
pub use scale::{ScaleKind, TrainingPixels};
pub use survey::Survey;
pub use threshold::Threshold;
