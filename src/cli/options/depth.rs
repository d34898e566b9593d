//! How true depth maps are stored.

use std::path::PathBuf;

use clap::Args;

use super::parse_pair;
use crate::dataset::DepthKind;
use crate::evaluate::{DepthFiles, DepthFit};

/// Names and values of depth maps. The folder is an option `depth` of the verb.
#[derive(Args)]
pub struct DepthOptions {
    /// File name of a frame's depth map; {} stands for the frame's file name without extension. It is looked for below
    /// the directories of the frame's name, with and without a leading `images`, and at last in the folder itself
    #[arg(long, value_name = "PATTERN", default_value = "{}_depth_0001.png")]
    depth_pattern: String,

    /// For PNG: depth in scene units = OFFSET + SCALE * p, p in [0, 1] from black to white; p = 0 means unknown, p = 1
    /// this far or farther. Millimetres in 16 bits, of a scene in metres: 0,65.535. Maps in .exr (their only channel,
    /// or the one named Z or depth) hold scene units, and 0 where depth is unknown
    #[arg(long, value_name = "OFFSET,SCALE", value_parser = parse_pair, allow_hyphen_values = true)]
    depth_encoding: Option<[f64; 2]>,

    /// Depth maps hold depth along the viewing axis, not distance from the camera
    #[arg(long)]
    pub z_depth: bool,
}

impl DepthOptions {
    /// Whether an option says what depth maps hold.
    pub fn are_given(&self) -> bool {
        self.depth_encoding.is_some() || self.z_depth
    }

    /// The maps in `folder`, or those that the camera file names.
    pub fn files(&self, folder: Option<PathBuf>) -> DepthFiles {
        let kind = if self.z_depth { DepthKind::Z } else { DepthKind::Euclidean };
        DepthFiles { folder, pattern: self.depth_pattern.clone(), scale: self.depth_encoding, kind }
    }
}

/// Says on stderr what is odd about depth maps.
pub fn tell(fit: &DepthFit) {
    fit.notes.iter().for_each(|note| announce!("note: {note}"));
    fit.warnings.iter().for_each(|warning| announce!("warning: {warning}"));
}
