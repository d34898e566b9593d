//! Splats: what is left in the format that the user wants, and what goes beside it.

use std::path::{Path, PathBuf};

use glam::Vec3;
use octobayes::Result;
use octobayes::estimate::Model;
use octobayes_clean::{Cleaned, Reason, Strength};
use octobayes_splats::Splats;

use super::found::{Found, TINTS, grey};

/// Splats and what goes of them.
pub struct FoundSplats<'a> {
    pub splats: &'a Splats,
    pub cleaned: Cleaned,
    /// Options that change the result, for the file: ` --by uncertainty`.
    pub options: String,
}

impl Found for FoundSplats<'_> {
    fn parts(&self) -> &'static str {
        "splats"
    }

    fn cleaned(&self) -> &Cleaned {
        &self.cleaned
    }

    fn number(&self, i: usize) -> usize {
        i
    }

    fn center(&self, i: usize) -> Vec3 {
        self.splats.mean(i)
    }

    fn before(&self) -> &dyn Model {
        self.splats
    }

    fn left(&self, strength: Strength) -> Result<Box<dyn Model + '_>> {
        Ok(Box::new(self.part(strength, false)?))
    }

    fn marked(&self, strength: Strength) -> Box<dyn Model + '_> {
        let color = |(i, reason): (usize, Option<Reason>)| {
            reason.map_or_else(|| grey(self.splats.constant_color(i)), |reason| TINTS[reason as usize].1)
        };
        let colors: Vec<Vec3> = self.cleaned.removed(strength).into_iter().enumerate().map(color).collect();
        Box::new(self.splats.in_colors(&colors))
    }
}

impl FoundSplats<'_> {
    /// The splats that go at a strength, or those that stay.
    pub fn part(&self, strength: Strength, goes: bool) -> Result<Splats> {
        self.splats.clone().keep(&self.chosen(strength, goes))
    }

    fn chosen(&self, strength: Strength, goes: bool) -> Vec<bool> {
        self.cleaned.removed(strength).iter().map(|reason| reason.is_some() == goes).collect()
    }

    /// Writes what goes to `removed`, if anything does, and what stays to `output`.
    pub fn write(&self, strength: Strength, output: &Path, removed: &Path) -> Result<()> {
        // What was removed first: nothing is lost if the disk is full.
        if self.chosen(strength, true).contains(&true) {
            self.write_columns(removed, &self.part(strength, true)?, strength, true)?;
        }
        self.write_left(&self.part(strength, false)?, strength, output)
    }

    /// Writes the splats that stay, which may have been trained since.
    pub fn write_left(&self, left: &Splats, strength: Strength, output: &Path) -> Result<()> {
        if Splats::takes_columns(output) {
            self.write_columns(output, left, strength, false)
        } else {
            left.write(output)
        }
    }

    /// Writes splats with columns of what the views show of them.
    fn write_columns(&self, path: &Path, splats: &Splats, strength: Strength, goes: bool) -> Result<()> {
        let Self { cleaned, .. } = self;
        let chosen = self.chosen(strength, goes);
        let of = |value: &dyn Fn(usize) -> f64| -> Vec<f32> {
            (0..chosen.len()).filter(|&i| chosen[i]).map(|i| value(i) as f32).collect()
        };
        let removed = cleaned.removed(strength);
        let reason = of(&|i| removed[i].map_or(0.0, |reason| f64::from(reason as u8 + 1)));
        let (front, views) = (of(&|i| cleaned.evidence.front_share(i)), of(&|i| f64::from(cleaned.evidence.views[i])));
        let score = of(&|i| cleaned.scores[i]);
        let version = env!("CARGO_PKG_VERSION");
        let names: Vec<String> =
            Reason::ALL.iter().map(|reason| format!("{} {}", *reason as u8 + 1, reason.name())).collect();
        let comments = [format!(
            "octobayes {version} clean --strength {strength}{}: octobayes_reason = 0 kept, {}; front_share = part of the \
             splat's weight in front of what the pixels show, and in empty pixels once a view contradicts it; \
             octobayes_score = how far the views contradict it, at most 1; views = training views that show it{}",
            self.options,
            names.join(", "),
            cleaned
                .uncertainty
                .as_ref()
                .map_or("", |_| "; uncertainty = U of its centre in the field, the prior's outside")
        )];
        let uncertainty = cleaned.uncertainty.as_ref().map(|u| of(&|i| u[i].uncertainty));
        let mut columns: Vec<(&str, &[f32])> = vec![
            ("octobayes_reason", &reason),
            ("octobayes_score", &score),
            ("front_share", &front),
            ("views", &views),
        ];
        columns.extend(uncertainty.as_ref().map(|u| ("uncertainty", &u[..])));
        splats.write_ply(path, &columns, &comments)
    }
}

/// The default file of what is removed.
pub fn beside(output: &Path) -> PathBuf {
    let stem = output.with_extension("");
    // Of `scene.compressed.ply`, too.
    let stem = if stem.extension().is_some_and(|e| e.eq_ignore_ascii_case("compressed")) {
        stem.with_extension("")
    } else {
        stem
    };
    let name = stem.file_name().unwrap_or_default().to_string_lossy().into_owned();
    stem.with_file_name(format!("{name}.removed.ply"))
}
