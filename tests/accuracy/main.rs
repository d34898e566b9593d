//! The numbers: against an independent oracle in f64, against symmetries of space, and within stated tolerances.

mod compare;
mod laws;
mod oracle;
mod ray_coverage;
mod rotation;
mod scenes;
mod self_check;
mod single;
mod tolerance;
mod zoo;
