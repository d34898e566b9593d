//! Which scenes, which sizes.

use octobayes::dataset::Hemisphere;
use octobayes::posterior::Covariance;
use octobayes::render::RayAverage;
use octobayes::synth::Up;
use octobayes::train::Selection;
use serde::Serialize;

/// Where a scene's images come from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum Data {
    /// NeRF-synthetic lego, 400 × 400, depth of 8 bits.
    Lego,
    /// A mesh of the data folder, ray-traced by `synth`.
    Mesh(&'static str, Up),
    /// A knot that this program makes, ray-traced by `synth`.
    Knot,
    /// 40 RGB-D frames of a kitchen, 320 × 240, depth of a sensor.
    Kitchen,
}

impl Data {
    /// Whether pictures may show the data set's own images: those of others are not this project's to give away.
    pub fn has_own_images(self) -> bool {
        matches!(self, Self::Mesh(..) | Self::Knot)
    }

    /// Whether pictures may show it at all: the terms of the scan of nefertiti (CC-BY-NC-SA) would hold for them.
    pub fn may_be_pictured(self) -> bool {
        !matches!(self, Self::Mesh("nefertiti", _))
    }
}

/// What is judged.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum Architecture {
    /// Trained here on the scene's views.
    HashGrid,
    /// That of the scene with this name, baked into voxels.
    BakedFrom(&'static str),
    /// The pretrained MLP of the data folder (lego, all 100 views).
    Mlp,
}

/// One model that saw too little, or enough.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scene {
    pub name: &'static str,
    pub data: Data,
    pub views: Selection,
    pub half: Option<Hemisphere>,
    pub architecture: Architecture,
    /// Whether an ensemble is trained too.
    pub ensemble: bool,
}

/// Sizes of everything.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    pub quick: bool,
    /// Pixels along the sides of synthetic images.
    pub resolution: u32,
    pub samples_per_side: u32,
    pub train_views: u32,
    pub test_views: u32,
    /// Of each model's training.
    pub steps: u64,
    pub log2_hashmap_size: u32,
    /// Of each uncertainty.
    pub rays: u64,
    /// Of the default reading.
    pub level: u8,
    pub other_levels: Vec<u8>,
    /// Factors of the default λ, beside 1; the smallest, or 1, is what the octree is made for.
    pub lambdas: Vec<f64>,
    /// Models of an ensemble, the judged one among them.
    pub members: u64,
    /// Pixels per side of a judged view, about.
    pub judged: u32,
    /// Most judged views.
    pub judged_views: usize,
    /// Most views of the clean-up.
    pub cleaned_views: usize,
    /// Grid points per axis of baked models.
    pub baked: usize,
}

/// How H is read.
pub const COVARIANCES: [Covariance; 3] = [Covariance::Diagonal, Covariance::Trace, Covariance::Block];
/// How log10 U becomes a pixel's at the default level; at others, and with another λ, it is `spread`.
pub const AVERAGES: [RayAverage; 2] = [RayAverage::WeightedMean, RayAverage::Spread];

impl Plan {
    pub fn full() -> Self {
        Self {
            quick: false,
            resolution: 200,
            samples_per_side: 3,
            train_views: 40,
            test_views: 16,
            steps: 1200,
            log2_hashmap_size: 15,
            rays: 480_000,
            level: 8,
            other_levels: vec![4, 5, 6, 7],
            lambdas: vec![1e3, 1e6],
            members: 10,
            judged: 66,
            judged_views: 12,
            cleaned_views: 3,
            baked: 192,
        }
    }

    pub fn quick() -> Self {
        Self {
            quick: true,
            resolution: 64,
            train_views: 12,
            test_views: 5,
            steps: 200,
            log2_hashmap_size: 13,
            rays: 20_000,
            level: 6,
            other_levels: vec![4, 5],
            lambdas: vec![1e4],
            members: 3,
            judged: 32,
            judged_views: 5,
            cleaned_views: 2,
            ..Self::full()
        }
    }

    /// In order of importance.
    pub fn scenes(&self) -> Vec<Scene> {
        let hash = |name, data, views, half, ensemble| Scene {
            name,
            data,
            views,
            half,
            architecture: Architecture::HashGrid,
            ensemble,
        };
        let few = |n| Selection::Count(n);
        let left = Some(Hemisphere::Left);
        let mesh = |file| Data::Mesh(file, Up::Y);
        if self.quick {
            return vec![hash("knot, 6 views", Data::Knot, few(6), None, true)];
        }
        let (bunny, spot, armadillo) = (mesh("stanford-bunny"), mesh("spot"), mesh("armadillo"));
        let nefertiti = Data::Mesh("nefertiti", Up::Z);
        let other = |name, views, half, architecture| Scene {
            name,
            data: Data::Lego,
            views,
            half,
            architecture,
            ensemble: false,
        };
        vec![
            hash("lego, 10 views", Data::Lego, few(10), None, true),
            hash("bunny, left half", bunny, Selection::All, left, true),
            hash("lego, left half", Data::Lego, Selection::All, left, false),
            hash("spot, 8 views", spot, few(8), None, true),
            hash("armadillo, left half", armadillo, Selection::All, left, false),
            hash("bunny, 8 views", bunny, few(8), None, false),
            hash("lego, 5 views", Data::Lego, few(5), None, false),
            hash("spot, left half", spot, Selection::All, left, false),
            hash("armadillo, 8 views", armadillo, few(8), None, false),
            hash("lego, 100 views", Data::Lego, Selection::All, None, false),
            hash("nefertiti, left half", nefertiti, Selection::All, left, false),
            hash("nefertiti, 8 views", nefertiti, few(8), None, false),
            hash("lego, 20 views", Data::Lego, few(20), None, false),
            hash("kitchen, 15 views", Data::Kitchen, few(15), None, false),
            other("lego, left half, baked", Selection::All, left, Architecture::BakedFrom("lego, left half")),
            other("lego, 100 views, baked", Selection::All, None, Architecture::BakedFrom("lego, 100 views")),
            other("lego, 100 views, pretrained MLP", Selection::All, None, Architecture::Mlp),
        ]
    }
}

impl Scene {
    /// A folder's or file's name.
    pub fn slug(&self) -> String {
        self.name.replace(", ", "-").replace(' ', "-")
    }
}
