//! Pre-trained models, which the repository does not ship: `OCTOBAYES_DATA` names their folder.

mod models;
mod sight;
mod splat_depth;
mod splat_judge;
mod splats;
