//! Cleaning of a trained scene: which splats, or cells of a volume, do the photographs contradict, and which does none
//! show?
//!
//! A *floater* hangs in the air in front of what the training views show. No view by itself contradicts it: each was
//! fitted with it. But the surface that one view shows behind it is in its place in others, so that the floater stands
//! in front of the surface of most pixels that it is part of. [`Clean`] measures that share in all views
//! ([`Evidence`]), removes what stands in front of surfaces, and looks again: a floater may itself be the surface that
//! hides another. How much goes is one word, a [`Strength`]; why, another, a [`Reason`].
//!
//! # Example
//! ```
//! use glam::{DVec3, Quat, Vec3};
//! use octobayes::geometry::Camera;
//! use octobayes_clean::{Clean, Reason, Strength};
//! use octobayes_splats::{RenderMode, Splats};
//!
//! // A wall of opaque splats, and a thin one that floats before it.
//! let on_wall = |i: i32| Vec3::new(4.0, (i % 20) as f32 / 10.0 - 1.0, (i / 20) as f32 / 10.0 - 1.0);
//! let mut means: Vec<Vec3> = (0..400).map(on_wall).collect();
//! means.push(Vec3::new(2.0, 0.3, 0.0));
//! let logits = (0..401).map(|i| if i < 400 { 4.0 } else { -1.0 }).collect();
//! let (log_scales, rotations) = (vec![Vec3::splat(-2.5); 401], vec![Quat::IDENTITY; 401]);
//! let splats = Splats::new(means, log_scales, rotations, logits, vec![0.0; 1203], 0, RenderMode::Classic)?;
//! let eyes = [-0.5, 0.0, 0.5].map(|y| DVec3::new(0.0, y, 0.0));
//! let cameras = eyes.map(|eye| Camera::look_at(eye, DVec3::X * 4.0, DVec3::Z, 0.4, [48, 48]));
//! let cleaned = Clean::new(&cameras).splats(&splats)?;
//! let gone = cleaned.removed(Strength::Careful);
//! assert_eq!(gone.iter().flatten().collect::<Vec<_>>(), [&Reason::Floating]);
//! # Ok::<(), octobayes::Error>(())
//! ```

mod evidence;
mod file;
mod rule;
mod run;
mod splats;
mod views;
mod volume;

pub use self::evidence::{Evidence, SHOWN, SLACK};
pub use self::file::{Baking, VolumeFile};
pub use self::rule::{Reason, Strength};
pub use self::run::{Clean, Cleaned, Removal};
pub use self::volume::{Cells, CleanedVolume};
// The study of the rule's constants tries others.
#[doc(hidden)]
pub use self::rule::{OfCells, Rule, Stage};
