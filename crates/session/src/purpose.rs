//! What a field is for, and the settings that follow from it.

use super::ScaleKind;
use octobayes::estimate::GridSettings;
use octobayes::monitor::Message;
use octobayes::posterior::Covariance;
use octobayes::{Error, Result};

/// The level at which U ranks pixels best, and at which the rays of a candidate view meet (`experiments/depth.md`,
/// `experiments/next_view.md`).
const COARSE_LEVEL: u8 = 6;

octobayes::choices! {
    /// What a field is for.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
    pub enum Purpose {
        Ranking = "ranking", "To rank pixels by their error of depth: level 6, covariance block";
        Depth = "depth",
        "How far depths may be off, in scene units: level 7, covariance block, --scale data";
        NextView = "next-view", "To choose the next photograph: level 6, --scale data, --keep-sums";
        Splats = "splats",
        "U, normals and ellipsoids of Gaussian splats: level 6 or 7, covariance block, --keep-sums, and --scale \
         data beside --noise";
    }
}

/// Settings that a user may leave open, because a purpose or the model suggests them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Choices {
    /// What the field is for.
    pub purpose: Option<Purpose>,
    /// Finest level.
    pub level: Option<u8>,
    /// What U² is of a vertex's matrix.
    pub covariance: Option<Covariance>,
    /// What U is a deviation of.
    pub scale: Option<ScaleKind>,
    /// The noise that training left.
    pub noise: Option<f64>,
    /// Whether the sums are kept.
    pub keep_sums: Option<bool>,
}

impl Choices {
    /// What U is a deviation of.
    #[must_use]
    pub fn scale(&self) -> ScaleKind {
        self.scale.or_else(|| self.suggested().2).unwrap_or_default()
    }

    /// Whether the sums are kept.
    #[must_use]
    pub fn keeps_sums(&self) -> bool {
        self.keep_sums.unwrap_or_else(|| self.suggested().1)
    }

    /// Covariance, whether the sums are kept, and the scale, as far as the purpose needs them.
    fn suggested(&self) -> (Option<Covariance>, bool, Option<ScaleKind>) {
        let (block, data) = (Some(Covariance::Block), Some(ScaleKind::Data));
        match self.purpose {
            None => (None, false, None),
            Some(Purpose::Ranking) => (block, false, None),
            Some(Purpose::Depth) => (block, false, data),
            Some(Purpose::NextView) => (None, true, data),
            Some(Purpose::Splats) => (block, true, data.filter(|_| self.noise.is_some())),
        }
    }

    /// The settings of a run, of so many splats if the model is one of splats. Notes what was not given and differs
    /// from the default. Warns of what was given and does not suit the purpose.
    ///
    /// # Errors
    /// If the purpose is splats, and the model is not.
    pub fn settle(
        &self,
        grid: GridSettings,
        count: Option<usize>,
        tell: &mut dyn FnMut(Message),
    ) -> Result<GridSettings> {
        let level = match (self.purpose, count) {
            (Some(Purpose::Splats), None) => {
                return Err(Error::setting("--for splats", "Gaussian splats", "another model"));
            }
            (None, None) => None,
            (None | Some(Purpose::Splats), Some(count)) => Some(level_of_splats(count)),
            (Some(Purpose::Depth), _) => Some(octobayes_depth::LEVEL),
            (Some(_), _) => Some(COARSE_LEVEL),
        };
        let (covariance, keeps_sums, scale) = self.suggested();
        let mut set = Vec::new();
        let mut is_open = |is_given: bool, text: Option<String>| set.extend(text.filter(|_| !is_given));
        is_open(self.level.is_some(), level.map(|level| format!("--level {level}")));
        is_open(self.covariance.is_some(), covariance.map(|covariance| format!("--covariance {}", covariance.name())));
        is_open(self.scale.is_some(), scale.map(|_| "--scale data".into()));
        is_open(self.keep_sums.is_some(), keeps_sums.then(|| "--keep-sums".into()));
        match (self.purpose, count) {
            (Some(purpose), _) if !set.is_empty() => {
                tell(Message::Note(format!("--for {} sets {}", purpose.name(), set.join(", "))));
            }
            (None, Some(count)) if !set.is_empty() => {
                tell(Message::Note(format!("{} by default for {count} splats", set.join(", "))));
            }
            _ => {}
        }
        if let Some(purpose) = self.purpose {
            let unfit = [
                (scale.is_some() && self.scale() == ScaleKind::Paper).then_some("--scale data"),
                (keeps_sums && self.keep_sums == Some(false)).then_some("--keep-sums"),
            ];
            for missing in unfit.into_iter().flatten() {
                let text = format!("--for {} needs {missing}, against what was given", purpose.name());
                tell(Message::Warning(text));
            }
        }
        Ok(grid
            .level(self.level.or(level).unwrap_or(grid.level))
            .covariance(self.covariance.or(covariance).unwrap_or(grid.covariance))
            .keep_sums(self.keeps_sums()))
    }
}

/// The default level of `count` splats: the edge of a cell is about two distances between splats that cover a surface
/// as wide as the box, √count of them along it. Where a cell holds one splat, U is up to 8 times too large, and coarser
/// cells blur (`docs/src/splats.md`). Finer levels than 7 rank errors of depth no better (`experiments/splats.md`).
fn level_of_splats(count: usize) -> u8 {
    if count > 1 << 15 { 7 } else { 6 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is set, and the remarks.
    fn settled(choices: Choices, count: Option<usize>) -> (GridSettings, Vec<String>) {
        let mut texts = Vec::new();
        let mut tell = |remark: Message| texts.push(remark.to_string());
        let grid = choices.settle(GridSettings::default(), count, &mut tell).unwrap();
        (grid, texts)
    }

    #[test]
    fn a_purpose_sets_what_was_not_given_and_lists_it() {
        let choices = Choices { purpose: Some(Purpose::NextView), ..Choices::default() };
        let (grid, texts) = settled(choices, None);
        assert_eq!((grid.level, grid.covariance, grid.keep_sums), (6, Covariance::Diagonal, true));
        assert_eq!(choices.scale(), ScaleKind::Data);
        assert_eq!(texts, ["note: --for next-view sets --level 6, --scale data, --keep-sums"]);

        let choices = Choices { purpose: Some(Purpose::Depth), level: Some(4), ..choices };
        let (grid, texts) = settled(Choices { covariance: Some(Covariance::Trace), ..choices }, None);
        assert_eq!((grid.level, grid.covariance, grid.keep_sums), (4, Covariance::Trace, false));
        assert_eq!(texts, ["note: --for depth sets --scale data"]);
        let open = Choices { purpose: Some(Purpose::Depth), ..Choices::default() };
        assert_eq!(settled(open, None).0.level, octobayes_depth::LEVEL);

        let next_view = Some(Purpose::NextView);
        let choices = Choices { purpose: next_view, scale: Some(ScaleKind::Paper), keep_sums: Some(false), ..choices };
        let (grid, texts) = settled(choices, None);
        assert!(!grid.keep_sums && choices.scale() == ScaleKind::Paper, "what was given wins");
        assert!(texts[0].starts_with("warning: --for next-view needs --scale data"), "{texts:?}");
        assert!(texts[1].starts_with("warning: --for next-view needs --keep-sums"), "{texts:?}");

        let choices = Choices { purpose: Some(Purpose::Ranking), ..Choices::default() };
        let (grid, _) = settled(choices, None);
        assert_eq!((grid.level, grid.covariance, grid.keep_sums), (6, Covariance::Block, false));
        assert_eq!(choices.scale(), ScaleKind::Paper);
    }

    #[test]
    fn splats_have_a_level_of_their_own_by_default() {
        let (grid, texts) = settled(Choices::default(), None);
        let papers = GridSettings::default().keep_sums(false);
        assert_eq!((grid, texts.len()), (papers, 0), "volumes keep the paper's");
        let (grid, texts) = settled(Choices::default(), Some(5));
        assert_eq!((grid.level, &*texts[0]), (6, "note: --level 6 by default for 5 splats"));
        assert_eq!([0, 32_768, 32_769, 3_000_000].map(level_of_splats), [6, 6, 7, 7]);
        let (grid, texts) = settled(Choices { level: Some(8), ..Choices::default() }, Some(5));
        assert_eq!((grid.level, texts.len()), (8, 0));

        let purpose = Choices { purpose: Some(Purpose::Splats), ..Choices::default() };
        let (grid, texts) = settled(purpose, Some(5));
        assert_eq!((grid.level, grid.covariance, grid.keep_sums), (6, Covariance::Block, true));
        assert_eq!(texts, ["note: --for splats sets --level 6, --covariance block, --keep-sums"]);
        assert_eq!(purpose.scale(), ScaleKind::Paper);
        assert_eq!(Choices { noise: Some(0.03), ..purpose }.scale(), ScaleKind::Data);
        let refused = purpose.settle(GridSettings::default(), None, &mut |_| {}).unwrap_err().to_string();
        assert!(refused.starts_with("--for splats: expected Gaussian splats"), "{refused}");
    }
}
