//! The purpose of the frames of a camera file: training, testing, or unstated.

use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};

use super::views::{Frame, Purpose};
use octobayes::{Error, Result};

/// The statements of a file.
#[derive(Debug, Default)]
pub(super) struct Lists {
    /// Names of the frames that were trained on (`train_filenames` of nerfstudio).
    pub training: Option<Vec<String>>,
    /// Names of the frames that were not (`test_filenames`, or else `val_filenames`).
    pub held_out: Option<Vec<String>>,
    /// Number of frames, in the order of their names, that were trained on (`n_frames` of instant-ngp).
    pub first: Option<usize>,
    /// Index of the first frame of a list of held-out frames (`test_frames` of ScanNet++).
    pub held_out_from: Option<usize>,
}

impl Lists {
    /// Sets the purpose of frames. Without any statement, they have none.
    ///
    /// Frames that stand in no list have no purpose but to be left out; where only held-out frames are listed, the
    /// others are for training. A frame of both lists was trained on.
    ///
    /// # Errors
    /// If a list has a name that no frame has.
    pub fn apply(&self, path: &Path, folder: &Path, frames: &mut [Frame]) -> Result<()> {
        if let Some(from) = self.held_out_from {
            let purpose = |i: usize| if i < from { Purpose::Training } else { Purpose::HeldOut };
            frames.iter_mut().for_each(|frame| frame.purpose = Some(purpose(frame.index)));
        }
        if self.training.is_some() || self.held_out.is_some() {
            let others = if self.training.is_some() { Purpose::Unused } else { Purpose::Training };
            frames.iter_mut().for_each(|frame| frame.purpose = Some(others));
            let mut of_name: HashMap<PathBuf, Vec<usize>> = HashMap::new();
            for (i, frame) in frames.iter().enumerate() {
                of_name.entry(plain(folder, &frame.name)).or_default().push(i);
            }
            let lists = [(&self.held_out, "held-out", Purpose::HeldOut), (&self.training, "train", Purpose::Training)];
            for (names, list, purpose) in lists {
                let mut seen = HashSet::new();
                for name in names.iter().flatten().filter(|name| seen.insert(*name)) {
                    let found = of_name.get(&plain(folder, name)).ok_or_else(|| {
                        let expected = "names of frames, as in their `file_path`";
                        Error::malformed(path, format!("list of {list} frames"), expected, format!("`{name}`"))
                    })?;
                    found.iter().for_each(|&i| frames[i].purpose = Some(purpose));
                }
            }
        }
        if let Some(count) = self.first.filter(|&count| count < frames.len()) {
            let mut order: Vec<usize> = (0..frames.len()).collect();
            order.sort_by(|&a, &b| natural(&frames[a].name, &frames[b].name));
            for (place, i) in order.into_iter().enumerate() {
                let own = frames[i].purpose.unwrap_or(Purpose::Training);
                frames[i].purpose = Some(if place < count { own } else { Purpose::Unused });
            }
        }
        Ok(())
    }
}

/// The path of a name, whichever way its slashes lean.
fn plain(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name.replace('\\', "/"));
    path.components().filter(|part| *part != Component::CurDir).collect()
}

/// The order of names in which numbers count as numbers: `r_2` comes before `r_10`.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.chars().peekable(), b.chars().peekable());
    loop {
        let (Some(&x), Some(&y)) = (a.peek(), b.peek()) else { return a.count().cmp(&b.count()) };
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let number = |chars: &mut std::iter::Peekable<std::str::Chars>| {
                let mut digits = String::new();
                while let Some(digit) = chars.next_if(char::is_ascii_digit) {
                    digits.push(digit);
                }
                digits.trim_start_matches('0').to_string()
            };
            let (x, y) = (number(&mut a), number(&mut b));
            match x.len().cmp(&y.len()).then(x.cmp(&y)) {
                Ordering::Equal => {}
                other => return other,
            }
        } else if x != y {
            return x.cmp(&y);
        } else {
            a.next();
            b.next();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes::field::ClosedForm;

    fn frames(names: &[&str]) -> Vec<Frame> {
        let cameras = ClosedForm::half_circle(names.len() as u32, [8, 8]).into_iter().zip(names).enumerate();
        cameras.map(|(index, (camera, name))| Frame { index, ..Frame::new(camera, *name, "") }).collect()
    }

    fn purposes(lists: &Lists, names: &[&str]) -> Result<String> {
        let mut frames = frames(names);
        lists.apply(Path::new("t.json"), Path::new("set"), &mut frames)?;
        let letter = |frame: &Frame| match frame.purpose {
            None => '?',
            Some(Purpose::Training) => 't',
            Some(Purpose::HeldOut) => 'h',
            Some(Purpose::Unused | Purpose::Planned) => '-',
        };
        Ok(frames.iter().map(letter).collect())
    }

    fn names(list: &[&str]) -> Option<Vec<String>> {
        Some(list.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn frames_are_for_what_their_file_says() {
        let all = ["images/a.png", "./images/b.png", "images\\c.png", "images/d.png"];
        let said = |lists: Lists| purposes(&lists, &all).unwrap();
        assert_eq!(said(Lists::default()), "????");
        let training = names(&["images/b.png", "images/c.png"]);
        assert_eq!(said(Lists { training: training.clone(), ..Lists::default() }), "-tt-");
        let held_out = names(&["./images/a.png", "images/b.png"]);
        assert_eq!(said(Lists { training, held_out: held_out.clone(), ..Lists::default() }), "htt-");
        assert_eq!(said(Lists { held_out, ..Lists::default() }), "hhtt");
        assert_eq!(said(Lists { held_out_from: Some(3), ..Lists::default() }), "ttth");
        let unknown = purposes(&Lists { training: names(&["b.png"]), ..Lists::default() }, &all).unwrap_err();
        assert_eq!(
            unknown.to_string(),
            "t.json: list of train frames: expected names of frames, as in their `file_path`, found `b.png`"
        );
    }

    #[test]
    fn the_first_frames_are_those_with_the_least_numbers() {
        let first = |count| Lists { first: Some(count), ..Lists::default() };
        assert_eq!(purposes(&first(2), &["r_10.png", "r_2.png", "r_1.png", "r_02a.png"]).unwrap(), "-tt-");
        assert_eq!(purposes(&first(9), &["r_10.png", "r_2.png"]).unwrap(), "??");
        assert_eq!(natural("r_2", "r_10"), Ordering::Less);
        assert_eq!(natural("r_2", "r_002"), Ordering::Equal);
        assert_eq!(natural("a9", "b1"), Ordering::Less);
        assert_eq!(natural("a", "a1"), Ordering::Less);
    }
}
