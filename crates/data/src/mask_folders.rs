//! Masks that no camera file names: pictures of the same names in a folder beside those of the pictures, as COLMAP,
//! gsplat, nerfstudio, Metashape and RealityCapture have them. Black is what was left out.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::path::{Component, Path, PathBuf};

use super::Frame;
use super::pictures::MaskFile;

/// What such a folder is called.
const FOLDERS: [&str; 2] = ["masks", "mask"];

/// Gives frames the masks that lie in folders below `root`, that of the data set, or beside the pictures. Returns what
/// a user should know of it.
pub(super) fn find_masks(root: &Path, frames: &mut [Frame]) -> Vec<String> {
    if frames.iter().any(|frame| matches!(frame.mask, Some(MaskFile::Kept(_)))) {
        return Vec::new();
    }
    let mut folders = HashMap::new();
    let masks: Vec<Option<PathBuf>> = frames.iter().map(|frame| mask_of(root, &frame.image, &mut folders)).collect();
    let found = masks.iter().flatten().count();
    let with_image = frames.iter().filter(|frame| frame.image.is_file()).count();
    let first = masks.iter().flatten().next().cloned();
    let without = frames.iter().zip(&masks).find(|(frame, mask)| mask.is_none() && frame.image.is_file());
    let without = without.map(|(frame, _)| frame.name.clone());
    for (frame, mask) in frames.iter_mut().zip(masks) {
        frame.mask = frame.mask.take().or(mask.map(MaskFile::Kept));
    }
    let mut notes = Vec::new();
    if let Some(first) = &first {
        let such = first.display();
        let others =
            without.filter(|_| found < with_image).map_or_else(String::new, |name| format!("; none for `{name}`"));
        notes.push(format!(
            "masks of {found} of {} frames lie beside the pictures, such as {such}: black was not trained on (if it \
             was, rename the folder){others}",
            frames.len()
        ));
    }
    let mut unused: Vec<&PathBuf> = folders
        .values()
        .flatten()
        .filter(|folder| {
            first.as_ref().is_none_or(|first| !first.starts_with(folder)) && !holds_pictures(folder, frames)
        })
        .collect();
    unused.sort();
    if let (Some(folder), true) = (unused.first(), found < with_image) {
        let name = frames.iter().find(|frame| frame.image.is_file()).and_then(|frame| frame.image.file_name());
        let example = name.map(|name| format!(", such as {}.png", name.display())).unwrap_or_default();
        notes.push(format!(
            "{} looks like masks and is not used: none of its files is named like a picture{example}",
            folder.display()
        ));
    }
    notes
}

fn holds_pictures(folder: &Path, frames: &[Frame]) -> bool {
    frames.iter().any(|frame| frame.image.starts_with(folder))
}

/// The mask of a picture, if it is there. `folders` keeps what was seen of each folder above pictures.
fn mask_of(root: &Path, image: &Path, folders: &mut HashMap<PathBuf, Vec<PathBuf>>) -> Option<PathBuf> {
    let file = image.file_name()?;
    let parent = image.parent()?;
    let beside = [("_mask", false), (".mask", false), (".mask", true)];
    let beside = beside.map(|(ending, is_whole)| parent.join(named(file, is_whole, &format!("{ending}.png"))));
    let names = [
        named(file, true, ".png"),
        named(file, false, ".png"),
        named(file, false, "_mask.png"),
        named(file, false, ".mask.png"),
        named(file, true, ".mask.png"),
        file.to_os_string(),
        named(file, false, ".jpg"),
        named(file, false, ".PNG"),
    ];
    let mut found = beside.into_iter().find(|path| path.is_file());
    // A picture elsewhere has its own folder, and the one around it.
    let is_below = parent.starts_with(root) && parent.is_absolute() == root.is_absolute();
    let levels = parent.ancestors().enumerate();
    for (_, level) in levels.take_while(|(i, level)| if is_below { level.starts_with(root) } else { *i < 2 }) {
        let below: Vec<Component> = parent.strip_prefix(level).ok()?.components().collect();
        if found.is_some() || below.contains(&Component::ParentDir) {
            break;
        }
        let of_level = folders.entry(level.to_path_buf()).or_insert_with(|| folders_like_masks(level));
        // Pictures that were made smaller have their own masks, `masks_2` for `images_2`.
        let ending = below.first().and_then(|c| c.as_os_str().to_str()?.rsplit_once('_')).map(|(_, ending)| ending);
        let mut known: Vec<&PathBuf> = of_level.iter().filter(|folder| is_for(folder, None)).collect();
        known.splice(0..0, of_level.iter().filter(|folder| ending.is_some() && is_for(folder, ending)));
        let candidates = known.into_iter().flat_map(|folder| {
            let depths = 0..=below.len().min(1);
            depths.rev().map(|skipped| folder.join(below[skipped..].iter().collect::<PathBuf>()))
        });
        found = candidates.flat_map(|folder| names.clone().map(|name| folder.join(name))).find(|path| path.is_file());
    }
    found.filter(|mask| mask != image)
}

/// Whether a folder is called `masks` or `mask`, with `_` and this ending if there is one.
fn is_for(folder: &Path, ending: Option<&str>) -> bool {
    let name = folder.file_name().and_then(OsStr::to_str).unwrap_or_default().to_lowercase();
    FOLDERS.iter().any(|own| ending.map_or(name == *own, |ending| name == format!("{own}_{ending}")))
}

/// The folders in a folder whose names have `mask` in them.
fn folders_like_masks(folder: &Path) -> Vec<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut like: Vec<PathBuf> = entries
        .filter(|entry| entry.file_name().to_string_lossy().to_lowercase().contains("mask"))
        .map(|entry| entry.path())
        .filter(|path| path.is_dir())
        .collect();
    like.sort();
    like
}

/// A name, whole or without its extension, with an ending.
fn named(file: &OsStr, is_whole: bool, ending: &str) -> OsString {
    let mut name = if is_whole { file } else { Path::new(file).file_stem().unwrap_or(file) }.to_os_string();
    name.push(ending);
    name
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use octobayes::geometry::Camera;

    /// Makes empty files, and returns the masks of `pictures` as paths below the folder, and the notes.
    fn found(files: &[&str], pictures: &[&str]) -> (Vec<String>, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        for file in files.iter().chain(pictures) {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [4, 2]);
        let frame = |name: &&str| Frame::new(camera, *name, folder.path().join(name));
        let mut frames: Vec<Frame> = pictures.iter().map(frame).collect();
        let notes = find_masks(folder.path(), &mut frames);
        let below = |frame: &Frame| {
            let Some(MaskFile::Kept(path)) = &frame.mask else { return String::new() };
            path.strip_prefix(folder.path()).unwrap().to_str().unwrap().replace('\\', "/")
        };
        let start = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
        (frames.iter().map(below).collect(), notes.iter().map(|note| note.replace(&start, "")).collect())
    }

    #[test]
    fn masks_have_the_names_of_their_pictures() {
        for (mask, picture) in [
            ("masks/a.jpg.png", "images/a.jpg"),
            ("masks/cam1/a.jpg.png", "images/cam1/a.jpg"),
            ("mask/a.png", "images/a.jpg"),
            ("Masks/a.png", "a.jpg"),
            ("masks/a.jpg", "images/a.jpg"),
            ("masks/a_mask.png", "images/a.jpg"),
            ("masks/images/a.png", "images/a.png"),
            ("images/masks/a.png", "images/a.png"),
            ("masks_2/a.png", "images_2/a.png"),
            ("masks/a.png", "images_4/a.png"),
            ("images/a_mask.png", "images/a.jpg"),
            ("images/a.jpg.mask.png", "images/a.jpg"),
        ] {
            let (masks, notes) = found(&[mask, "mask_of_sky/b.png"], &[picture]);
            assert_eq!(masks, [mask], "{picture}");
            assert!(notes.len() == 1 && notes[0].starts_with("masks of 1 of 1 frames lie beside"), "{notes:?}");
        }
        let (masks, _) = found(&["masks/a.png", "masks_2/a.png"], &["images_2/a.png"]);
        assert_eq!(masks, ["masks_2/a.png"]);
    }

    #[test]
    fn folders_that_look_like_masks_and_are_not_used_are_named() {
        let (masks, notes) = found(&["masks/other.png"], &["images/a.jpg", "images/b.jpg"]);
        assert_eq!(masks, ["", ""]);
        assert_eq!(
            notes,
            ["masks looks like masks and is not used: none of its files is named like a picture, such as a.jpg.png"]
        );
        let (masks, notes) = found(&["masks/b.png", "my_masks/a.png"], &["images/a.jpg", "images/b.jpg"]);
        assert_eq!(masks, ["", "masks/b.png"]);
        assert!(notes[0].ends_with("(if it was, rename the folder); none for `images/a.jpg`"), "{notes:?}");
        assert!(notes[1].starts_with("my_masks looks like masks and is not used"), "{notes:?}");
        // Pictures may lie in a folder of such a name, and be no masks of themselves.
        assert_eq!(found(&[], &["masks/a.png", "masks/b.png"]), (vec![String::new(), String::new()], Vec::new()));
    }
}
