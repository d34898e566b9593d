//! Which files of a folder the demo made, so that it replaces these and no others.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::cli::identity::Identity;
use crate::io::{AtomicFile, read};
use crate::{Error, Result};

/// The list of these files, in their folder.
pub const LIST: &str = "demo.json";

/// Names of files, and the checksum of what was written; none while a run is under way.
#[derive(Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct List {
    made_by_octobayes_demo: BTreeMap<String, Option<u32>>,
}

/// The files of a run.
pub struct Made {
    folder: PathBuf,
    list: List,
    /// What had their names before.
    before: Vec<(String, Identity)>,
}

impl Made {
    /// Claims `names` in `folder` for a run.
    pub fn claim<'a>(folder: &Path, names: impl Iterator<Item = &'a str>) -> Result<Self> {
        let refused = |file: &Path| {
            let expected = "nothing, or a file that `demo` wrote and nobody changed";
            Err(Error::malformed(file, "file in --output", expected, "another file; choose another folder"))
        };
        let path = folder.join(LIST);
        let mut list = List::default();
        if path.exists() {
            match serde_json::from_slice(&read(&path)?) {
                Ok(found) => list = found,
                Err(_) => return refused(&path),
            }
        }
        let mut before = Vec::new();
        for name in names {
            let file = folder.join(name);
            if file.exists() {
                let is_own = match list.made_by_octobayes_demo.get(name) {
                    Some(Some(checksum)) => crc32fast::hash(&read(&file)?) == *checksum,
                    Some(None) => true,
                    None => false,
                };
                if !is_own {
                    return refused(&file);
                }
            }
            before.push((name.to_string(), Identity::new(&file)));
        }
        list.made_by_octobayes_demo.extend(before.iter().map(|(name, _)| (name.clone(), None)));
        let made = Self { folder: folder.to_path_buf(), list, before };
        made.write()?;
        Ok(made)
    }

    /// Stores what the run wrote.
    pub fn finish(mut self) -> Result<()> {
        for (name, _) in &self.before {
            let checksum = crc32fast::hash(&read(&self.folder.join(name))?);
            self.list.made_by_octobayes_demo.insert(name.clone(), Some(checksum));
        }
        self.write()
    }

    /// The error of a run, and what that wrote before.
    pub fn after(&self, error: Error) -> Error {
        let is_new = |(name, before): &&(String, Identity)| {
            let path = self.folder.join(name);
            path.exists() && Identity::new(&path) != *before
        };
        let new: Vec<&str> = self.before.iter().filter(is_new).map(|(name, _)| name.as_str()).collect();
        match error {
            Error::Interrupted if !new.is_empty() => {
                Error::InterruptedAfter { finished: format!("{} holds {}", self.folder.display(), new.join(", ")) }
            }
            other => other,
        }
    }

    fn write(&self) -> Result<()> {
        let path = self.folder.join(LIST);
        let mut file = AtomicFile::create(&path)?;
        let text = serde_json::to_string_pretty(&self.list).unwrap_or_default();
        writeln!(file, "{text}").map_err(Error::io(&path, "cannot write"))?;
        file.commit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_demo_made_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let claim = |names: &[&str]| Made::claim(folder.path(), names.iter().copied());
        let refused = |names: &[&str]| claim(names).err().map(|error| error.to_string()).unwrap_or_default();
        std::fs::write(path("transforms.json"), "precious").unwrap();
        assert!(refused(&["a", "transforms.json"]).contains("transforms.json: file in --output: expected nothing"));
        assert!(!path(LIST).exists(), "a refusal writes nothing");

        // An unfinished run has claimed its files; a finished one has recorded them.
        let made = claim(&["a", "b"]).unwrap();
        assert!(matches!(made.after(Error::Interrupted), Error::Interrupted));
        std::fs::write(path("a"), "half").unwrap();
        let said = made.after(Error::Interrupted).to_string();
        assert!(said.starts_with("interrupted; ") && said.ends_with(" holds a"), "{said}");
        assert_eq!(made.after(Error::setting("x", "y", "z")).to_string(), "x: expected y, found z");
        drop(made);
        let made = claim(&["a", "b"]).unwrap();
        ["a", "b"].iter().for_each(|name| std::fs::write(path(name), "done").unwrap());
        made.finish().unwrap();
        claim(&["a"]).unwrap().finish().unwrap();
        std::fs::write(path("b"), "changed").unwrap();
        assert!(refused(&["a", "b"]).contains("b: file in --output"));
        claim(&["a"]).unwrap();

        std::fs::write(path(LIST), "{\"frames\": []}").unwrap();
        assert!(refused(&["a"]).contains("demo.json: file in --output"));
        assert_eq!(std::fs::read(path("transforms.json")).unwrap(), b"precious");
    }
}
