//! How true depth maps are stored.

use std::path::PathBuf;

use clap::Args;

use super::parse_pair;
use crate::Result;
use crate::dataset::{DepthEncoding, DepthKind};
use crate::evaluate::{DepthError, DepthFiles};
use crate::metrics::quantile;

/// Names and values of depth maps. The folder is an option `depth` of the verb.
#[derive(Args)]
pub struct DepthOptions {
    /// File name of a frame's depth map; {} stands for the frame's file name without extension
    #[arg(long, value_name = "PATTERN", default_value = "{}_depth_0001.png")]
    depth_pattern: String,

    /// For PNG: depth in scene units = OFFSET + SCALE * p, p in [0, 1] from black to white; p = 0 means unknown.
    /// Maps in .exr (their only channel, or the one named Z or depth) hold scene units, and 0 where depth is unknown
    #[arg(long, value_name = "OFFSET,SCALE", value_parser = parse_pair, allow_hyphen_values = true, requires = "depth")]
    depth_encoding: Option<[f64; 2]>,

    /// Depth maps hold depth along the viewing axis, not distance from the camera
    #[arg(long)]
    pub z_depth: bool,
}

impl DepthOptions {
    /// Which depth the maps hold.
    pub fn kind(&self) -> DepthKind {
        if self.z_depth { DepthKind::Z } else { DepthKind::Euclidean }
    }

    /// The maps in `folder`.
    pub fn files(&self, folder: PathBuf) -> Result<DepthFiles> {
        let pattern = self.depth_pattern.clone();
        let encoding = DepthEncoding::of_maps(&pattern, self.depth_encoding, self.kind())?;
        Ok(DepthFiles { folder, pattern, encoding })
    }

    /// Says on stderr if the depth maps fit much better when read as the other kind of depth; `otherwise` are the
    /// errors then.
    pub fn note_kind(&self, depth: &DepthError, mut otherwise: Vec<f64>) {
        otherwise.sort_unstable_by(f64::total_cmp);
        let (found, other) = (depth.median, quantile(&otherwise, 0.5));
        if other < 0.5 * found {
            let (kind, flag) = match self.kind() {
                DepthKind::Z => ("distance from the camera", "without --z-depth"),
                _ => ("depth along the viewing axis", "with --z-depth"),
            };
            announce!(
                "note: half of the depths are off by more than {found:.4} scene units; if the maps hold {kind} \
                 ({flag}), by more than {other:.4}"
            );
        }
    }
}
