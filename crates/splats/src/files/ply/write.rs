//! Writes `.ply` files that renderers and editors of splats read.

use std::io::Write;
use std::path::Path;

use super::super::super::columns::{Field, Layout};
use super::super::super::{RenderMode, Splats, coefficients};
use super::{DILATION, MODE, place_of_rest};
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// What comments of this crate begin with.
const OWN: &str = "octobayes ";

impl Splats {
    /// Writes a `.ply` file: the properties that were read in their order, then new `columns` of n values.
    ///
    /// Parameters are `float`, others have the type that they were read with. A column takes the place of a property of
    /// its name. The header has the comments that were read, the render mode, and new `comments`, which begin with
    /// "octobayes". [`Splats::read`] returns the same numbers, bit for bit. The file appears complete or not at all.
    ///
    /// # Errors
    /// If a column's name is that of a parameter or appears twice, if it does not have n finite values, if a comment
    /// has several lines, or if writing fails.
    pub fn write_ply(&self, path: &Path, columns: &[(&str, &[f32])], comments: &[String]) -> Result<()> {
        let layout = self.layout_with(columns, comments)?;
        let mut file = AtomicFile::create(path)?;
        let mut row = Vec::new();
        let mut written = file.write_all(header(&layout, self.len()).as_bytes());
        for i in 0..self.len() {
            row.clear();
            layout.order.iter().for_each(|field| self.put(*field, &layout, i, &mut row));
            written = written.and_then(|()| file.write_all(&row));
        }
        written.map_err(Error::io(path, "cannot write"))?;
        file.commit()
    }

    fn layout_with(&self, columns: &[(&str, &[f32])], comments: &[String]) -> Result<Layout> {
        let mut layout = self.layout.clone();
        for (i, (name, values)) in columns.iter().enumerate() {
            if columns[..i].iter().any(|(other, _)| other == name) {
                return Err(Error::setting("columns", "names once each", format!("`{name}` twice")));
            }
            layout.append(name, values, self.len())?;
        }
        let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
        layout.comments = self.comments_with(comments, &names)?;
        Ok(layout)
    }

    /// The comments that were read, of our own those alone that are about columns that stay, as none of `columns` takes
    /// their place; the render mode; and new ones.
    pub(in super::super) fn comments_with(&self, comments: &[String], columns: &[&str]) -> Result<Vec<String>> {
        let mut all = self.layout.comments.clone();
        let is_new = |name: &str| columns.contains(&name);
        let stays = |comment: &String| {
            let mut named = self.extra_names().into_iter().filter(|name| comment.contains(&format!("{name} = ")));
            named.clone().next().is_some() && !named.any(is_new)
        };
        all.retain(|comment| !comment.starts_with(OWN) || stays(comment));
        let mode = match self.mode {
            RenderMode::Classic => "default",
            RenderMode::Mip | RenderMode::MipSplatting => "mip",
        };
        all.push(format!("{MODE} {mode}"));
        if self.mode == RenderMode::MipSplatting {
            all.push(format!("{DILATION} {}", self.mode.dilation()));
        }
        for comment in comments {
            if comment.contains(char::is_control) {
                return Err(Error::setting("comment", "one line of text", format!("`{comment}`")));
            }
            let own = if comment.starts_with(OWN) { "" } else { OWN };
            all.push(format!("{own}{comment}"));
        }
        Ok(all)
    }

    /// Appends the number of splat `i` that a field means.
    fn put(&self, field: Field, layout: &Layout, i: usize, row: &mut Vec<u8>) {
        let value = match field {
            Field::Mean(axis) => self.means[i][axis],
            Field::Scale(axis) => self.log_scales[i][axis],
            Field::Rotation(entry) => self.rotations[i].to_array()[(entry + 3) % 4],
            Field::Opacity => self.opacity_logits[i],
            Field::Constant(channel) => self.sh(i)[channel],
            Field::Rest(entry) => self.sh(i)[place_of_rest(entry, coefficients(self.degree))],
            Field::Extra(index) => return row.extend(layout.extras[index].of(i)),
        };
        row.extend(value.to_le_bytes());
    }
}

fn header(layout: &Layout, count: usize) -> String {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    layout.comments.iter().for_each(|comment| header += &format!("comment {comment}\n"));
    header += &format!("element vertex {count}\n");
    for field in &layout.order {
        let kind = match field {
            Field::Extra(index) => layout.extras[*index].kind.name(),
            _ => "float",
        };
        header += &format!("property {kind} {}\n", field.name(&layout.extras));
    }
    header + "end_header\n"
}

#[cfg(test)]
mod tests {
    use std::fs;

    use glam::{Quat, Vec3};

    use super::*;

    fn splats(degree: u8) -> Splats {
        let n = 5;
        let means = (0..n).map(|i| Vec3::new(i as f32, 0.1, -1.0 / 3.0)).collect();
        let scales = vec![Vec3::new(-3.0, -4.5, -6.1); n];
        let rotations = (0..n).map(|i| Quat::from_xyzw(0.3, -0.2, i as f32, 1.0).normalize()).collect();
        let logits = (0..n).map(|i| i as f32 - 2.0).collect();
        let sh = (0..n * 3 * coefficients(degree)).map(|i| (i as f32).sin()).collect();
        Splats::new(means, scales, rotations, logits, sh, degree, RenderMode::Mip).unwrap()
    }

    fn names(path: &Path) -> Vec<String> {
        let bytes = fs::read(path).unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let header = text.split("end_header").next().unwrap();
        header.lines().filter_map(|line| line.strip_prefix("property ")).map(str::to_string).collect()
    }

    #[test]
    fn what_is_written_is_read_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.ply");
        for (degree, mode) in (0..=3).zip(RenderMode::ALL.into_iter().cycle()) {
            let whole = splats(degree).with_mode(mode);
            whole.write_ply(&path, &[], &[]).unwrap();
            assert_eq!(Splats::read(&path).unwrap(), whole);
            let first = fs::read(&path).unwrap();
            assert_eq!(names(&path)[..4], ["float x", "float y", "float z", "float nx"]);
            Splats::read(&path).unwrap().write_ply(&path, &[], &[]).unwrap();
            assert_eq!(fs::read(&path).unwrap(), first, "byte for byte");
        }
    }

    #[test]
    fn columns_come_last_and_take_the_place_of_older_ones() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second] = ["a.ply", "b.ply"].map(|name| folder.path().join(name));
        let whole = splats(1).with_comments(vec!["by hand".into()]);
        let (u, w) = ([1.0, 2.0, 3.0, 4.0, 5.0], [0.5; 5]);
        whole
            .write_ply(
                &first,
                &[("uncertainty", &u), ("weight", &w)],
                &["uncertainty = in scene units".into(), "weight = of pixels".into(), "trained".into()],
            )
            .unwrap();
        let read = Splats::read(&first).unwrap();
        assert_eq!(read.extra_names(), ["nx", "ny", "nz", "uncertainty", "weight"]);
        assert_eq!(
            read.comments(),
            ["by hand", "octobayes uncertainty = in scene units", "octobayes weight = of pixels", "octobayes trained"]
        );
        assert_eq!((read.extra("uncertainty"), read.mode()), (Some(u.map(f64::from).to_vec()), RenderMode::Mip));
        // The next run has another scale, and no weights; three of the five splats are left.
        let part = read.keep(&[true, false, true, true, false]).unwrap();
        part.write_ply(&second, &[("uncertainty", &[7.0, 8.0, 9.0])], &["octobayes 2".into()]).unwrap();
        let again = Splats::read(&second).unwrap();
        assert_eq!(names(&second).last().unwrap(), "float uncertainty");
        assert_eq!(
            (again.extra("weight"), again.extra("uncertainty")),
            (Some(vec![0.5; 3]), Some(vec![7.0, 8.0, 9.0]))
        );
        // What is about a column that stays.
        assert_eq!(again.comments(), ["by hand", "octobayes weight = of pixels", "octobayes 2"]);
        assert_eq!(again.means(), [0, 2, 3].map(|i| whole.mean(i)));
        assert_eq!(again.sh(1), whole.sh(2));
    }

    #[test]
    fn properties_keep_their_order_and_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.ply");
        let kinds =
            ["double depth", "float opacity", "uchar label", "int id", "float x", "float z", "float y", "short part"];
        let others =
            ["rot_3", "rot_2", "rot_1", "rot_0", "scale_1", "scale_0", "scale_2", "f_dc_0", "f_dc_1", "f_dc_2"];
        let mut lines: Vec<String> = kinds.map(String::from).to_vec();
        lines.extend(others.map(|name| format!("float {name}")));
        let properties: String = lines.iter().map(|line| format!("property {line}\n")).collect();
        let mode = "comment SplatRenderMode: default\n";
        let header = format!("ply\nformat binary_little_endian 1.0\n{mode}element vertex 1\n{properties}end_header\n");
        let mut bytes = header.into_bytes();
        bytes.extend((-1.5_f64).to_le_bytes());
        bytes.extend(2.0_f32.to_le_bytes());
        bytes.push(200);
        bytes.extend((-70_000_i32).to_le_bytes());
        [1.0_f32, 3.0, 2.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.extend((-300_i16).to_le_bytes());
        [0.0_f32, 0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        fs::write(&path, &bytes).unwrap();
        let splats = Splats::read(&path).unwrap();
        let extra = |name: &str| splats.extra(name).unwrap()[0];
        assert_eq!(["depth", "label", "id", "part"].map(extra), [-1.5, 200.0, -70_000.0, -300.0]);
        splats.write_ply(&path, &[], &[]).unwrap();
        assert_eq!(fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn what_would_not_be_read_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.ply");
        let good = [1.0_f32; 5];
        let refused = |columns: &[(&str, &[f32])], comments: &[String]| {
            let error = splats(0).write_ply(&path, columns, comments).unwrap_err().to_string();
            assert!(!path.exists());
            error
        };
        for name in ["opacity", "f_rest_3", "", "two words"] {
            let error = refused(&[(name, &good)], &[]);
            assert_eq!(error, format!("column: expected a word that names no parameter of splats, found `{name}`"));
        }
        let error = refused(&[("u", &good), ("u", &good)], &[]);
        assert_eq!(error, "columns: expected names once each, found `u` twice");
        assert_eq!(refused(&[("u", &good[1..])], &[]), "column `u`: expected 5 values, one per splat, found 4");
        let error = refused(&[("u", &[1.0, 1.0, f32::NAN, 1.0, 1.0])], &[]);
        assert_eq!(error, "column `u`: expected finite values, found NaN of splat 2");
        assert!(refused(&[], &["a\nend_header".into()]).contains("comment: expected one line of text"));
    }
}
