//! What the experiments share: scenes, clocks, tables, kept rows, and reports that a program writes.
//!
//! An experiment is a program with parts. Every part writes one block of `experiments/NAME.md`, between markers; the
//! words around it are written by hand. Without arguments all parts run:
//!
//! ```text
//! cargo experiment NAME -- [PART ...] [--work DIR] [--fresh]
//! ```
//!
//! Rows that are finished are kept in the work folder, `target/experiments/NAME` by default, until their block is
//! written. A run that was killed goes on from there.

// Not published.
#![allow(missing_docs)]

pub mod ball;
pub mod clock;
pub mod fisher;
pub mod halved;
pub mod index;
pub mod isolation;
pub mod kitchen;
pub mod knot;
pub mod memory;
pub mod meshes;
pub mod pixel_gradient;
pub mod program;
pub mod ranking;
pub mod recall;
pub mod report;
pub mod scenes;
pub mod settings;
pub mod surface;
pub mod table;
pub mod tables;
pub mod train;
pub mod visibility;
pub mod work;
