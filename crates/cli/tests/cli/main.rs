//! The program as scripts see it: what each verb reads, writes, says and refuses.
//!
//! One test program for many subjects, because each links the whole library.

mod accumulate;
mod answers;
#[path = "../arrays/mod.rs"]
mod arrays;
mod beside;
mod bounds;
mod camera_files;
mod cameras;
mod clean;
mod clusters;
mod depth;
mod depth_maps;
mod evaluate;
#[cfg(unix)]
#[path = "../interrupt/mod.rs"]
mod interrupt;
mod limits;
mod misleading;
mod next_view;
#[path = "../arrays/npz.rs"]
mod npz;
#[path = "../program/mod.rs"]
mod program;
mod refusals;
mod scale;
mod splats;
mod streams;
mod synth;
mod train;
