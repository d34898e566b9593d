//! What a folder of a data set means: which of its camera files is read, and for which part of its frames.

use std::path::{Path, PathBuf};

use super::Part;
use super::colmap::ModelFiles;
use octobayes::io::place::folder_of;

fn has_name(path: &Path, names: &[&str]) -> bool {
    path.file_name().is_some_and(|name| names.iter().any(|known| name == *known))
}

/// Whether a camera file lists held-out frames alone, by its name.
pub(super) fn is_held_out_by_name(path: &Path) -> bool {
    has_name(path, &["transforms_test.json", "transforms_val.json"])
}

/// The camera file that `path` means for a part. Of a folder it is `transforms_train.json` or `transforms_test.json`,
/// or else `transforms.json` or the COLMAP model, in this order.
#[must_use]
pub fn camera_file(path: &Path, part: Part) -> PathBuf {
    let of_part = match part {
        Part::Training => "transforms_train.json",
        Part::HeldOut => "transforms_test.json",
    };
    let mut files = [of_part, "transforms.json"].map(|name| path.join(name)).into_iter();
    files.find(|file| file.is_file()).unwrap_or_else(|| path.to_path_buf())
}

/// The file by which the folder of `path` is a data set already, if a camera file of this name would seem to be that
/// data set's: it would be read in the place of a COLMAP model, or as the other part of its frames.
#[must_use]
pub fn taken_for(path: &Path) -> Option<PathBuf> {
    const NAMES: [&str; 4] =
        ["transforms.json", "transforms_train.json", "transforms_test.json", "transforms_val.json"];
    if !has_name(path, &NAMES) {
        return None;
    }
    let listed = NAMES[1..].iter().map(|name| path.with_file_name(name)).filter(|file| file != path && file.exists());
    listed.chain(ModelFiles::all(folder_of(path)).into_iter().map(|model| model.images)).next()
}

/// The note if [`camera_file`] found `file` in a folder that has a COLMAP model as well.
#[must_use]
pub fn passed_over(folder: &Path, file: &Path) -> Option<String> {
    let model = ModelFiles::all(folder).into_iter().next().filter(|_| folder != file)?;
    let [folder, file, model] = [folder, file, &model.images].map(|path| path.display());
    Some(format!("{folder} has two sources of cameras: {file} is read, and not COLMAP's {model} (name it to read it)"))
}

/// The file of held-out frames that belongs to a file of training frames, if it exists.
#[must_use]
pub fn test_partner(path: &Path) -> Option<PathBuf> {
    let partner = path.with_file_name("transforms_test.json");
    (has_name(path, &["transforms_train.json"]) && partner.exists()).then_some(partner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `train --splats -o set/m.ply` once wrote `set/transforms.json`, and the next command read it for the data set's.
    #[test]
    fn a_camera_file_does_not_join_a_data_set() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let put = |name: &str| {
            std::fs::create_dir_all(path(name).parent().unwrap()).unwrap();
            std::fs::write(path(name), "").unwrap();
        };
        for (set, other) in [
            ("project", "sparse/0/images.bin"),
            ("flat", "sparse/images.txt"),
            ("below", "colmap/sparse/0/images.bin"),
            ("undistorted", "dense/sparse/images.bin"),
            ("model", "images.bin"),
            ("blender", "transforms_train.json"),
            ("tests", "transforms_test.json"),
        ] {
            put(&format!("{set}/{other}"));
            put(&format!("{set}/{}", other.replace("images.", "cameras.")));
            let written = path(&format!("{set}/transforms.json"));
            assert_eq!(taken_for(&written), Some(path(&format!("{set}/{other}"))), "{set}");
            let is_colmap = other.contains("images");
            // The folder alone means the model, until there is a transforms.json.
            assert_eq!(passed_over(&path(set), &path(set)), None, "{set}");
            put(&format!("{set}/transforms.json"));
            let said = passed_over(&path(set), &camera_file(&path(set), Part::Training));
            assert_eq!(said.is_some(), is_colmap, "{set}: {said:?}");
            assert!(said.is_none_or(|said| said.contains("transforms.json is read") && said.contains(other)));
            assert_eq!(taken_for(&path(&format!("{set}/next.json"))), None, "no data set has this name");
        }
        put("own/transforms.json");
        put("own/m.ply");
        assert_eq!((taken_for(&path("own/transforms.json")), taken_for(&path("none/transforms.json"))), (None, None));
        assert_eq!(passed_over(&path("own"), &path("own/transforms.json")), None);
    }

    #[test]
    fn a_folder_means_the_file_of_the_part() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::write(folder.path().join(name), b"").unwrap();
        let named = |part| camera_file(folder.path(), part);
        ["cameras.txt", "images.txt"].into_iter().for_each(write);
        assert_eq!(named(Part::Training), folder.path(), "a model of COLMAP");
        write("transforms.json");
        assert_eq!(
            [named(Part::Training), named(Part::HeldOut)],
            ["transforms.json"; 2].map(|name| folder.path().join(name))
        );
        ["transforms_train.json", "transforms_test.json"].into_iter().for_each(write);
        let file = folder.path().join("transforms_train.json");
        assert_eq!(named(Part::Training), file);
        assert_eq!(named(Part::HeldOut), folder.path().join("transforms_test.json"));
        assert_eq!(camera_file(&file, Part::HeldOut), file);
    }
}
