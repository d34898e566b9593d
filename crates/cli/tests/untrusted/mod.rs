//! Files from strangers: small valid ones of every kind that the program reads, ways to build faulty ones, and
//! readers that also use what they read. The tests of damaged files and the fuzz targets in `fuzz/` share this
//! module.

#[path = "../arrays/mod.rs"]
pub mod arrays;
pub mod damage;
pub mod forge;
pub mod probe;
pub mod samples;
pub mod splats;
pub mod torch;

/// The kinds of files that the program reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `.oct` field.
    Field,
    /// State of an unfinished run.
    Checkpoint,
    /// `.ppng` model.
    Ppng,
    /// Camera file.
    Transforms,
    /// `.npz` ray samples.
    Samples,
    /// `.npz` voxel grid.
    Voxels,
    /// `.npy` points.
    Points,
    /// `.npy` grid of the official code.
    Official,
    /// `.safetensors` model.
    Safetensors,
    /// Checkpoint of PyTorch.
    Torch,
    /// `.obj` mesh.
    Mesh,
    /// `.csv` points.
    Csv,
    /// Image or depth map.
    Image,
    /// `.exr` depth map.
    Exr,
    /// Gaussian splats: `.ply`, `.compressed.ply` or `.spz`, which are told apart by their content; and `.splat`.
    Splats,
    /// `cameras`, `images` and `points3D` of COLMAP, in one file: see [`forge::colmap`].
    Colmap,
}

impl Kind {
    pub const ALL: [Self; 16] = [
        Self::Field,
        Self::Checkpoint,
        Self::Ppng,
        Self::Transforms,
        Self::Samples,
        Self::Voxels,
        Self::Points,
        Self::Official,
        Self::Safetensors,
        Self::Torch,
        Self::Mesh,
        Self::Csv,
        Self::Image,
        Self::Exr,
        Self::Splats,
        Self::Colmap,
    ];

    /// Name of a file of this kind, with the extension that the program expects.
    pub fn file_name(self) -> &'static str {
        match self {
            Self::Field => "field.oct",
            Self::Checkpoint => "run.chk",
            Self::Ppng => "model.ppng",
            Self::Transforms => "transforms.json",
            Self::Samples => "samples.npz",
            Self::Voxels => "voxels.npz",
            Self::Points => "points.npy",
            Self::Official => "official.npy",
            Self::Safetensors => "model.safetensors",
            Self::Torch => "model.ckpt",
            Self::Mesh => "mesh.obj",
            Self::Csv => "points.csv",
            Self::Image => "image.png",
            Self::Exr => "depth.exr",
            Self::Splats => "scene.ply",
            Self::Colmap => "model.colmap",
        }
    }
}
