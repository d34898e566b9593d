//! One model of a run: its settings, its files, and what a run that goes on with it must share.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Args;
use octobayes::geometry::Domain;
use octobayes::{Error, Result};
use octobayes_models::HashGridConfig;
use octobayes_train::{Budget, DatasetFiles, Description, Shot, StateFile, TrainSettings};

/// One model to train.
pub(super) struct Member {
    pub settings: TrainSettings,
    pub path: PathBuf,
    pub state: StateFile,
    pub description: serde_json::Value,
}

/// Where the state of a model's run is kept.
pub(super) fn state_file(model: &Path) -> PathBuf {
    model.with_extension("state")
}

impl Args {
    /// The file of the k-th model.
    pub(super) fn member_file(&self, k: u64) -> PathBuf {
        if self.members == 1 {
            return self.output.clone();
        }
        let mut name = self.output.file_stem().unwrap_or_default().to_os_string();
        name.push(format!("-{k}.safetensors"));
        self.output.with_file_name(name)
    }

    /// The k-th model.
    pub(super) fn member(&self, k: u64, files: &DatasetFiles, train: &[Shot]) -> Result<Member> {
        let settings = TrainSettings {
            config: HashGridConfig::default().log2_hashmap_size(self.log2_hashmap_size),
            seed: self.seed.wrapping_add(k),
            background: self.background,
            samples_per_step: self.samples_per_step,
            ..TrainSettings::default()
        };
        let path = self.member_file(k);
        let state = state_file(&path);
        let description = self.description(files, train, settings, self.domain(files)?)?;
        let key = description.to_string();
        let state = StateFile { path: state, key, every: StateFile::EVERY };
        // A restart replaces this file, so it must not be another one.
        if self.restart && state.path.exists() {
            state.check()?;
        }
        Ok(Member { settings, path, state, description })
    }

    /// What a run with these settings must share with the one that it resumes.
    pub(super) fn description<S: Serialize>(
        &self,
        files: &DatasetFiles,
        train: &[Shot],
        settings: S,
        domain: Domain,
    ) -> Result<serde_json::Value> {
        let budget = match self.budget() {
            Budget::Steps(steps) => format!("{steps} steps"),
            Budget::Time(time) => format!("{} s", time.as_secs_f64()),
        };
        let description = Description {
            version: env!("CARGO_PKG_VERSION"),
            dataset: files.path.display().to_string(),
            cameras: Description::checksum(&files.path)?,
            views: self.views.clone().unwrap_or_default(),
            images: train.len(),
            pictures: Shot::checksum(train),
            settings,
            domain,
            budget,
        };
        serde_json::to_value(description).map_err(|e| Error::setting("run", "a description", e.to_string()))
    }
}
