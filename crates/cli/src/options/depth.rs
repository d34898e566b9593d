//! How true depth maps are stored.

use std::path::PathBuf;

use clap::Args;

use super::{heading, parse_pair};
use crate::given::Given;
use octobayes::Result;
use octobayes_data::DepthKind;
use octobayes_evaluation::DepthFiles;

/// Names and values of depth maps. The folder is an option `depth` of the verb.
#[derive(Args)]
pub struct DepthOptions {
    /// File name of a frame's depth map; {} stands for the frame's file name without extension. It is looked for below
    /// the directories of the frame's name, with and without a leading `images`, and at last in the folder itself
    #[arg(long, value_name = "PATTERN", default_value = DepthFiles::PATTERN, help_heading = heading::INPUT)]
    depth_pattern: String,

    /// For PNG: depth in scene units = OFFSET + SCALE * p, p in [0, 1] from black to white; p = 0 means unknown, p = 1
    /// this far or farther. Millimetres in 16 bits, of a scene in metres: 0,65.535. Maps in .exr (their only channel,
    /// or the one named Z or depth) or .npy hold scene units, and 0 where depth is unknown
    #[arg(
        long,
        value_name = "OFFSET,SCALE",
        value_parser = parse_pair,
        allow_hyphen_values = true,
        help_heading = heading::INPUT,
    )]
    depth_encoding: Option<[f64; 2]>,

    /// Depth maps hold depth along the viewing axis, not distance from the camera
    #[arg(long, help_heading = heading::INPUT, hide_short_help = true)]
    z_depth: bool,
}

impl DepthOptions {
    /// Refuses a pattern of names where no folder has them.
    pub fn check(given: &Given, has_folder: bool) -> Result<()> {
        if has_folder {
            return Ok(());
        }
        given.refuse(&["--depth-pattern"], "a folder of depth maps (--depth)", "none: the camera file names each map")
    }

    /// The maps in `folder`, or those that the camera file names.
    pub fn files(&self, folder: Option<PathBuf>) -> DepthFiles {
        let kind = if self.z_depth { DepthKind::Z } else { DepthKind::Euclidean };
        DepthFiles { folder, pattern: self.depth_pattern.clone(), scale: self.depth_encoding, kind }
    }
}
