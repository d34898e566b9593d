//! Judging splats whose depth is known.

mod data;
