//! What the original code of Gaussian splatting was run with, as it writes it beside its models.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::Vec3;

use octobayes::io::place::folder_of;

/// The file of a run's settings, a `Namespace(key=value, …)` of Python.
const NAME: &str = "cfg_args";
/// Such files have some hundred bytes; more are not read.
const LONGEST: u64 = 1 << 16;
/// Larger pictures are reduced to this width, unless the run has a `resolution`.
const WIDEST: f64 = 1600.0;

/// Settings of a training.
#[derive(Debug)]
pub(super) struct TrainingArgs {
    /// Where they stand.
    pub path: PathBuf,
    entries: Vec<(String, String)>,
}

impl TrainingArgs {
    /// Those that stand beside one of these files, or above its `point_cloud/iteration_N`.
    pub fn beside(files: &[impl AsRef<Path>]) -> Option<Self> {
        let folders = files.iter().map(AsRef::as_ref).flat_map(|file| {
            let own = if file.is_dir() { file } else { folder_of(file) };
            let is_iteration = own.file_name().is_some_and(|name| name.to_string_lossy().starts_with("iteration_"));
            std::iter::once(own.to_path_buf()).chain(is_iteration.then(|| own.join("../..")))
        });
        folders.map(|folder| folder.join(NAME)).find_map(|path| {
            let mut text = Vec::new();
            // A pipe would never end.
            let file = path.is_file().then(|| File::open(&path).ok())??;
            file.take(LONGEST).read_to_end(&mut text).ok()?;
            let entries = entries(&String::from_utf8_lossy(&text));
            (!entries.is_empty()).then_some(Self { path, entries })
        })
    }

    fn value(&self, key: &str) -> Option<&str> {
        self.entries.iter().find(|(own, _)| own == key).map(|(_, value)| value.as_str())
    }

    fn truth(&self, key: &str) -> Option<bool> {
        match self.value(key)? {
            "True" | "1" => Some(true),
            "False" | "0" => Some(false),
            _ => None,
        }
    }

    /// What lay behind the splats.
    pub fn background(&self) -> Option<Vec3> {
        self.truth("white_background").map(|is_white| if is_white { Vec3::ONE } else { Vec3::ZERO })
    }

    /// Whether frames were held out.
    pub fn is_evaluated(&self) -> Option<bool> {
        self.truth("eval")
    }

    /// The size of the images of the training, from that of a picture (`utils/camera_utils.py`, `loadCam`).
    pub fn size(&self, picture: &Path, size: [u32; 2]) -> Option<[u32; 2]> {
        let resolution: f64 = self.value("resolution")?.parse().ok()?;
        let [width, height] = size.map(|side| (f64::from(side) / self.factor(picture)).round());
        let divisor = match resolution {
            1.0 | 2.0 | 4.0 | 8.0 => {
                let side = |side: f64| ((side / resolution).round_ties_even() as u32).max(1);
                return Some([side(width), side(height)]);
            }
            -1.0 if width > WIDEST => width / WIDEST,
            -1.0 => 1.0,
            columns if columns > 0.0 => width / columns,
            _ => return None,
        };
        let side = |side: f64| ((side / divisor) as u32).max(1);
        Some([side(width), side(height)])
    }

    /// How much smaller the pictures of the training were than `picture`, by the names of their folders.
    fn factor(&self, picture: &Path) -> f64 {
        let images = self.value("images").unwrap_or_default();
        let is_that_folder = picture.parent().and_then(Path::file_name).is_some_and(|name| name == images);
        let factor = images.strip_prefix("images_").and_then(|factor| factor.parse::<u8>().ok());
        factor.filter(|&factor| factor > 0 && !is_that_folder).map_or(1.0, f64::from)
    }
}

/// The keys and values of a `Namespace`. Strings lose their quotation marks.
fn entries(text: &str) -> Vec<(String, String)> {
    let Some((_, inside)) = text.split_once('(') else { return Vec::new() };
    let mut entries = Vec::new();
    let (mut depth, mut quote, mut is_escaped, mut entry) = (0, None, false, String::new());
    for next in inside.chars() {
        match quote {
            _ if is_escaped => is_escaped = false,
            Some(_) if next == '\\' => is_escaped = true,
            Some(mark) if next == mark => quote = None,
            Some(_) => {}
            None if matches!(next, '\'' | '"') => quote = Some(next),
            None if matches!(next, '(' | '[' | '{') => depth += 1,
            None if depth > 0 && matches!(next, ')' | ']' | '}') => depth -= 1,
            None if depth == 0 && matches!(next, ',' | ')') => {
                if let Some((key, value)) = entry.split_once('=') {
                    let value = value.trim().trim_matches(['\'', '"']);
                    entries.push((key.trim().to_string(), value.to_string()));
                }
                entry.clear();
                continue;
            }
            None => {}
        }
        entry.push(next);
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> TrainingArgs {
        TrainingArgs { path: PathBuf::new(), entries: entries(text) }
    }

    #[test]
    fn one_key_of_a_namespace_is_read() {
        for (text, expected) in [
            ("Namespace(sh_degree=3, white_background=False, eval=True)", Some(false)),
            ("Namespace(white_background=True)", Some(true)),
            ("Namespace(white_background = True )", Some(true)),
            ("Namespace(source_path='/x, white_background=True, y', white_background=False)", Some(false)),
            ("Namespace(a='it\\'s white_background=True', white_background=False)", Some(false)),
            ("Namespace(a=\"it's\", white_background=True)", Some(true)),
            ("Namespace(a=[7000, 30000], b=(1, 2), white_background=True)", Some(true)),
            ("Namespace(not_white_background=True)", None),
            ("Namespace(white_background_of=True)", None),
            ("Namespace(white_background=None, eval=True)", None),
            ("Namespace(source_path='/x, white_background=True", None),
            ("Namespace(a='\\", None),
            ("Namespace(a='\\é', white_background=True)", Some(true)),
            ("", None),
        ] {
            let color = expected.map(|is_white| if is_white { Vec3::ONE } else { Vec3::ZERO });
            assert_eq!(of(text).background(), color, "{text}");
        }
        assert_eq!(of("Namespace(eval=False)").is_evaluated(), Some(false));
    }

    #[test]
    fn they_are_found_beside_a_file_and_above_its_iteration() {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("point_cloud/iteration_7000");
        std::fs::create_dir_all(&own).unwrap();
        std::fs::write(folder.path().join(NAME), "Namespace(white_background=False)").unwrap();
        let of = |path: PathBuf| TrainingArgs::beside(&[&path]).and_then(|args| args.background());
        assert_eq!(of(own.join("point_cloud.ply")), Some(Vec3::ZERO));
        assert_eq!(of(folder.path().join("cameras.json")), Some(Vec3::ZERO));
        assert_eq!(of(folder.path().join("point_cloud/x.ply")), None);
        std::fs::write(own.join(NAME), "Namespace(white_background=True)").unwrap();
        assert_eq!(of(own.join("point_cloud.ply")), Some(Vec3::ONE));
    }

    /// Sizes of published data: the bicycle of mip-NeRF 360 and the truck of Tanks and Temples.
    #[test]
    fn sizes_of_trainings_follow_the_original_code() {
        for (settings, picture, size, expected) in [
            ("images='images', resolution=-1", "images/a.jpg", [4946, 3286], Some([1600, 1063])),
            ("images='images', resolution=-1", "images/a.jpg", [979, 546], Some([979, 546])),
            ("images='images', resolution=2", "images/a.jpg", [979, 546], Some([490, 273])),
            // 978 / 4 = 244.5: Python rounds to even.
            ("images='images', resolution=4", "images/a.jpg", [978, 546], Some([244, 136])),
            ("images='images', resolution=800", "images/a.jpg", [4946, 3286], Some([800, 531])),
            ("images='images_4', resolution=-1", "images/a.jpg", [4946, 3286], Some([1237, 822])),
            ("images='images_4', resolution=-1", "s/images_4/a.jpg", [1237, 822], Some([1237, 822])),
            ("images='images_4', resolution=1", "images/a.jpg", [4946, 3286], Some([1237, 822])),
            ("images='images_0', resolution=-1", "images/a.jpg", [979, 546], Some([979, 546])),
            ("images='images', resolution=0", "images/a.jpg", [979, 546], None),
            ("images='images', resolution=nan", "images/a.jpg", [979, 546], None),
            ("images='images'", "images/a.jpg", [979, 546], None),
        ] {
            let found = of(&format!("Namespace({settings})")).size(Path::new(picture), size);
            assert_eq!(found, expected, "{settings}, {picture}");
        }
    }
}
