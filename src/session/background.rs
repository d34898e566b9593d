//! What lay behind splats in training, as the original code writes it beside them.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::Vec3;

use crate::io::place::folder_of;

/// The file of a run's settings, a `Namespace(key=value, …)` of Python.
const NAME: &str = "cfg_args";
const KEY: &str = "white_background";
/// Such files have some hundred bytes; more are not read.
const LONGEST: u64 = 1 << 16;

/// The background that a `cfg_args` states beside one of these files, or above its `point_cloud/iteration_N`; and the
/// path of that file.
pub(super) fn stated(files: &[&Path]) -> Option<(PathBuf, Vec3)> {
    let folders = files.iter().flat_map(|file| {
        let own = if file.is_dir() { file } else { folder_of(file) };
        let is_iteration = own.file_name().is_some_and(|name| name.to_string_lossy().starts_with("iteration_"));
        std::iter::once(own.to_path_buf()).chain(is_iteration.then(|| own.join("../..")))
    });
    folders.map(|folder| folder.join(NAME)).find_map(|path| {
        let mut text = Vec::new();
        // A pipe would never end.
        let file = path.is_file().then(|| File::open(&path).ok())??;
        file.take(LONGEST).read_to_end(&mut text).ok()?;
        let is_white = value(&String::from_utf8_lossy(&text))?;
        Some((path, if is_white { Vec3::ONE } else { Vec3::ZERO }))
    })
}

/// The value of the key in a `Namespace`; nothing inside quotes is one.
fn value(text: &str) -> Option<bool> {
    let (mut quote, mut last, mut rest) = (None, ' ', text);
    while let Some(next) = rest.chars().next() {
        match quote {
            Some(_) if next == '\\' => rest = rest.get(1..)?,
            Some(mark) if next == mark => quote = None,
            Some(_) => {}
            None if next == '\'' || next == '"' => quote = Some(next),
            None if !last.is_alphanumeric() && last != '_' => {
                let value = rest.strip_prefix(KEY).and_then(|rest| rest.trim_start().strip_prefix('='));
                let word = value.map(|value| value.trim_start().split(|c: char| !c.is_alphanumeric()).next());
                match word {
                    Some(Some("True" | "1")) => return Some(true),
                    Some(Some("False" | "0")) => return Some(false),
                    Some(_) => return None,
                    None => {}
                }
            }
            None => {}
        }
        last = next;
        let mut characters = rest.chars();
        characters.next();
        rest = characters.as_str();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_key_of_a_namespace_is_read() {
        for (text, expected) in [
            ("Namespace(sh_degree=3, white_background=False, eval=True)", Some(false)),
            ("Namespace(white_background=True)", Some(true)),
            ("Namespace(white_background = True )", Some(true)),
            ("Namespace(source_path='/x, white_background=True, y', white_background=False)", Some(false)),
            ("Namespace(a='it\\'s white_background=True', white_background=False)", Some(false)),
            ("Namespace(a=\"it's\", white_background=True)", Some(true)),
            ("Namespace(not_white_background=True)", None),
            ("Namespace(white_background_of=True)", None),
            ("Namespace(white_background=None, eval=True)", None),
            ("Namespace(source_path='/x, white_background=True", None),
            ("Namespace(a='\\", None),
            ("Namespace(a='\\é', white_background=True)", Some(true)),
            ("", None),
        ] {
            assert_eq!(value(text), expected, "{text}");
        }
    }

    #[test]
    fn it_is_found_beside_a_file_and_above_its_iteration() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("point_cloud/iteration_7000");
        std::fs::create_dir_all(&own).unwrap();
        std::fs::write(folder.path().join(NAME), "Namespace(white_background=False)").unwrap();
        let of = |path: PathBuf| stated(&[&path]).map(|(_, color)| color);
        assert_eq!(of(own.join("point_cloud.ply")), Some(Vec3::ZERO));
        assert_eq!(of(folder.path().join("cameras.json")), Some(Vec3::ZERO));
        assert_eq!(of(folder.path().join("point_cloud/x.ply")), None);
        std::fs::write(own.join(NAME), "Namespace(white_background=True)").unwrap();
        assert_eq!(of(own.join("point_cloud.ply")), Some(Vec3::ONE));
    }
}
