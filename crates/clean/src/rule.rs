//! When a part goes, and why.

use crate::Evidence;

octobayes::choices! {
    /// How much goes. What goes at one strength goes at those after it.
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
    pub enum Strength {
        Careful = "careful", "nothing that the photographs show but what nearly all of them show in front of surfaces";
        #[default]
        Normal = "normal", "what most photographs show in front of surfaces";
        Strong = "strong", "what half of the photographs show in front of surfaces";
    }
}

octobayes::choices! {
    /// Why a part goes. The number of a reason in a file is its place here, from 1.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
    pub enum Reason {
        Floating = "floating", "hangs in front of the surfaces that training views show";
        Unseen = "unseen", "is beside the images of all training views, or, if it is a splat, behind surfaces";
        Outside = "outside", "is far outside everything that the training views show";
        Transparent = "transparent", "is so thin that hardly a pixel shows it";
        Loose = "loose", "has a larger U than nearly all visible surfaces, if it goes by that alone";
    }
}

impl Reason {
    /// What people read behind the number of parts.
    #[must_use]
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::Floating => "float in front of what the photographs show",
            Self::Unseen => "are seen by no camera",
            Self::Outside => "lie far outside everything",
            Self::Transparent => "are nearly transparent",
            Self::Loose => "are held more loosely than nearly all visible surfaces",
        }
    }
}

/// Below this weight a part lies between the pixels that were looked at.
const LEAST_WEIGHT: f64 = 0.01;

/// What is removed as floating, and looked for again without it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// The strength from which on it goes.
    pub strength: Strength,
    /// A part floats if its [`Rule::score`] exceeds this.
    pub threshold: f64,
    /// Whether [`Evidence::free_share`] contradicts a part, not [`Evidence::front_share`].
    pub by_free_share: bool,
}

/// Constants for the cells of a volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OfCells {
    /// [`Rule::on`].
    pub on: f64,
    /// How far before a surface a cell may still be of it, in cells.
    pub reach: f64,
}

/// The constants of the rule, which `cargo experiment clean` fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// One after the other.
    pub stages: [Stage; 4],
    /// Most rounds of removing and looking again in a stage.
    pub rounds: usize,
    /// How much a view in which the centre is at a surface counts for a part.
    pub on: f64,
    /// What is otherwise for cells of a volume, whose surfaces are soft.
    pub of_cells: OfCells,
    /// A part is transparent if its opacity is below this, `[Strength]`.
    pub opacity: [f64; 3],
    /// A part that the views show less than this, as its largest share of a pixel, is shown by none.
    pub peak: f64,
    /// Parts are outside if they are so many times as far away as all that the views show but for [`Rule::beyond`].
    pub far: f64,
    /// The part of what the views show that counts as outside, too.
    pub beyond: f64,
}

impl Default for Rule {
    fn default() -> Self {
        Self {
            stages: [
                Stage { strength: Strength::Careful, threshold: 0.9, by_free_share: false },
                Stage { strength: Strength::Normal, threshold: 0.7, by_free_share: false },
                Stage { strength: Strength::Strong, threshold: 0.5, by_free_share: false },
                Stage { strength: Strength::Strong, threshold: 0.5, by_free_share: true },
            ],
            rounds: 2,
            on: 0.25,
            of_cells: OfCells { on: 1.0, reach: 0.5 },
            opacity: [0.005, 0.005, 0.02],
            peak: 1.0 / 255.0,
            far: 5.0,
            beyond: 1e-3,
        }
    }
}

impl Rule {
    /// How far the views contradict part `i` in a stage: the part of its weight in front of surfaces, less a part of
    /// the share of views in which its centre is at one. At most 1.
    #[must_use]
    pub fn score(&self, of: &Evidence, i: usize, stage: Stage) -> f64 {
        let at_surface = f64::from(of.on[i]) / f64::from(of.inside[i].max(1));
        // What lies between the pixels that were looked at may be a thin thing in its place.
        let share = match () {
            () if of.weight[i] < LEAST_WEIGHT => 0.0,
            () if stage.by_free_share => of.free_share(i),
            () => of.front_share(i),
        };
        share - self.on * at_surface
    }

    /// Whether no view shows part `i`.
    #[must_use]
    pub fn is_unseen(&self, of: &Evidence, i: usize) -> bool {
        f64::from(of.peak[i]) < self.peak && of.on[i] == 0 && of.before[i] == 0 && of.masked[i] == 0
    }
}
