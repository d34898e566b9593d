//! `.ply` of the original code, with any properties in any order.

use std::path::Path;

use glam::{Vec3, Vec4};

use super::super::columns::{Extra, Field, Layout};
use super::super::{RenderMode, Splats, coefficients};
use super::compressed;
use super::header::{Element, Property, parse};
use super::raw::Raw;
use crate::{Error, Result};

/// The header's comment that states the [`RenderMode`].
pub(in crate::splats) const MODE: &str = "SplatRenderMode:";

/// Reads the bytes of a PLY file, compressed or not.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Splats> {
    let mut ply = parse(path, bytes)?;
    let mode = mode_of(path, &mut ply.comments)?;
    let Some(vertex) = ply.elements.iter().position(|element| element.name == "vertex") else {
        let names: Vec<String> = ply.elements.iter().map(|element| format!("`{}`", element.name)).collect();
        return Err(Error::malformed(path, "header", "an element `vertex`", format!("elements {}", names.join(", "))));
    };
    if ply.elements[vertex].property("packed_position").is_some() {
        return compressed::read(path, &ply, mode);
    }
    if let Some(other) = ply.elements.iter().find(|element| element.name != "vertex") {
        let found = format!("an element `{}`", other.name);
        return Err(Error::malformed(path, "header", "the element `vertex` alone", found));
    }
    let (layout, degree) = layout(path, &ply.elements[vertex], ply.comments)?;
    numbers(&ply.elements[vertex], &layout, degree, mode).finish(path, Some(layout))
}

/// Takes the render mode out of the comments.
fn mode_of(path: &Path, comments: &mut Vec<String>) -> Result<RenderMode> {
    let mut mode = RenderMode::Classic;
    for comment in comments.extract_if(.., |comment| comment.trim_start().starts_with(MODE)) {
        mode = match comment.trim_start()[MODE.len()..].trim() {
            "mip" => RenderMode::Mip,
            "default" | "classic" => RenderMode::Classic,
            other => {
                let place = format!("header, comment `{MODE}`");
                return Err(Error::malformed(path, place, "`mip` or `default`", format!("`{other}`")));
            }
        };
    }
    Ok(mode)
}

/// The meaning of all properties, and the degree that follows from their number.
fn layout(path: &Path, vertex: &Element, comments: Vec<String>) -> Result<(Layout, u8)> {
    let mut extras = Vec::new();
    let mut meaning = |property: &Property| {
        Field::named(&property.name).unwrap_or_else(|| {
            let bytes = vertex.rows.chunks_exact(vertex.stride).flat_map(|row| property.of(row)).copied().collect();
            extras.push(Extra { name: property.name.clone(), kind: property.kind, bytes });
            Field::Extra(extras.len() - 1)
        })
    };
    let order: Vec<Field> = vertex.properties.iter().map(&mut meaning).collect();
    let rest = order.iter().filter(|field| matches!(field, Field::Rest(_))).count();
    let Some(degree) = (0..=super::super::MAX_DEGREE).find(|degree| 3 * (coefficients(*degree) - 1) == rest) else {
        let expected = "0, 9, 24 or 45 properties `f_rest_…`, spherical harmonics of degree 0 to 3";
        return Err(Error::malformed(path, "header", expected, rest.to_string()));
    };
    if let Some(missing) = Field::all(degree).into_iter().find(|field| !order.contains(field)) {
        let name = missing.name(&[]);
        let hint = match missing {
            Field::Scale(2) => " (2D splats have no third scale; only 3D splats are read)",
            Field::Constant(_) => " (points with colours are no splats)",
            _ => "",
        };
        let names: Vec<&str> = vertex.properties.iter().map(|property| property.name.as_str()).collect();
        return Err(Error::malformed(path, "header", format!("a property `{name}`{hint}"), names.join(" ")));
    }
    Ok((Layout { order, extras, comments }, degree))
}

/// The parameters of all rows.
fn numbers(vertex: &Element, layout: &Layout, degree: u8, mode: RenderMode) -> Raw {
    let (n, k) = (vertex.count, coefficients(degree));
    let mut raw = Raw {
        means: vec![Vec3::ZERO; n],
        log_scales: vec![Vec3::ZERO; n],
        rotations: vec![Vec4::ZERO; n],
        opacity_logits: vec![0.0; n],
        sh: vec![0.0; n * 3 * k],
        degree,
        mode,
    };
    for (i, row) in vertex.rows.chunks_exact(vertex.stride).enumerate() {
        for (field, property) in layout.order.iter().zip(&vertex.properties) {
            let entry = match *field {
                Field::Mean(axis) => &mut raw.means[i][axis],
                Field::Scale(axis) => &mut raw.log_scales[i][axis],
                // The file begins with w.
                Field::Rotation(entry) => &mut raw.rotations[i][(entry + 3) % 4],
                Field::Opacity => &mut raw.opacity_logits[i],
                Field::Constant(channel) => &mut raw.sh[i * 3 * k + channel],
                Field::Rest(entry) => &mut raw.sh[i * 3 * k + place_of_rest(entry, k)],
                Field::Extra(_) => continue,
            };
            *entry = property.number(row) as f32;
        }
    }
    raw
}

/// Where `f_rest_[entry]` belongs among the `3 k` coefficients of a splat.
pub(in crate::splats) const fn place_of_rest(entry: usize, k: usize) -> usize {
    let (channel, higher) = (entry / (k - 1), entry % (k - 1));
    3 * (1 + higher) + channel
}

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;

    /// A file of these properties, whose numbers are the names' places in the list in eighths, a hundred more in each
    /// row.
    fn file(properties: &[&str], comments: &str) -> Vec<u8> {
        let lines: String = properties.iter().map(|property| format!("property {property}\n")).collect();
        let header = format!("ply\nformat binary_little_endian 1.0\n{comments}element vertex 2\n{lines}end_header\n");
        let mut bytes = header.into_bytes();
        for row in 0..2 {
            for (i, property) in properties.iter().enumerate() {
                let value = 100 * row + i;
                match property.split(' ').next().unwrap() {
                    "float" => bytes.extend((value as f32 / 8.0).to_le_bytes()),
                    "double" => bytes.extend((value as f64 / 8.0).to_le_bytes()),
                    "uchar" => bytes.push(value as u8),
                    other => panic!("{other}"),
                }
            }
        }
        bytes
    }

    fn properties(rest: usize) -> Vec<String> {
        let mut all: Vec<String> = ["float rot_3", "uchar label", "double x", "float z", "float y", "float opacity"]
            .map(String::from)
            .to_vec();
        all.extend((0..rest).map(|i| format!("float f_rest_{i}")));
        let others = ["scale_2", "scale_1", "f_dc_0", "f_dc_1", "f_dc_2", "scale_0", "rot_0", "rot_1", "rot_2", "time"];
        all.extend(others.map(|name| format!("float {name}")));
        all
    }

    fn read_file(properties: &[&str], comments: &str) -> Result<Splats> {
        read(Path::new("s.ply"), &file(properties, comments))
    }

    #[test]
    fn properties_are_found_by_their_names() {
        for (degree, rest) in [(0, 0), (1, 9), (2, 24)] {
            let all = properties(rest);
            let names: Vec<&str> = all.iter().map(String::as_str).collect();
            let splats = read_file(&names, "comment made by hand\n").unwrap();
            let at = |name: &str| names.iter().position(|p| p.ends_with(&format!(" {name}"))).unwrap() as f32 / 8.0;
            assert_eq!((splats.degree(), splats.len(), splats.mode()), (degree, 2, RenderMode::Classic));
            assert_eq!(splats.mean(1), Vec3::new(at("x"), at("y"), at("z")) + 12.5);
            assert_eq!(splats.log_scales()[0], Vec3::new(at("scale_0"), at("scale_1"), at("scale_2")));
            assert_eq!(splats.opacity_logits(), [5.0, 105.0].map(|v| v / 8.0));
            let [w, x, y, z] = [0, 1, 2, 3].map(|i| at(&format!("rot_{i}")));
            let angle = splats.rotation(0).dot(Quat::from_xyzw(x, y, z, w).normalize());
            assert!((angle - 1.0).abs() < 1e-6, "{angle}");
            let k = coefficients(degree);
            for c in 0..3 {
                assert_eq!(splats.sh(1)[c], at(&format!("f_dc_{c}")) + 12.5);
                for higher in 1..k {
                    let name = format!("f_rest_{}", c * (k - 1) + higher - 1);
                    assert_eq!(splats.sh(1)[3 * higher + c], at(&name) + 12.5, "{name}");
                }
            }
            assert_eq!(splats.extra_names(), ["label", "time"]);
            assert_eq!(splats.extra("label"), Some(vec![1.0, 101.0]));
        }
    }

    #[test]
    fn the_render_mode_is_read_from_the_header() {
        let all = properties(0);
        let names: Vec<&str> = all.iter().map(String::as_str).collect();
        let mode = |comment: &str| read_file(&names, comment).map(|splats| splats.mode());
        assert_eq!(mode("comment SplatRenderMode: mip\n").unwrap(), RenderMode::Mip);
        assert_eq!(mode("comment SplatRenderMode: default\n").unwrap(), RenderMode::Classic);
        let error = mode("comment SplatRenderMode: soft\n").unwrap_err().to_string();
        assert!(error.contains("comment `SplatRenderMode:`: expected `mip` or `default`, found `soft`"), "{error}");
    }

    #[test]
    fn files_of_something_else_are_refused_by_what_they_lack() {
        let all = properties(9);
        let without = |name: &str| -> Vec<&str> {
            all.iter().map(String::as_str).filter(|p| !p.ends_with(&format!(" {name}"))).collect()
        };
        for (name, expected) in [
            ("scale_2", "a property `scale_2` (2D splats have no third scale"),
            ("f_dc_1", "a property `f_dc_1` (points with colours are no splats)"),
            ("opacity", "a property `opacity`, found rot_3 label x z y"),
            ("f_rest_8", "0, 9, 24 or 45 properties `f_rest_…`, spherical harmonics of degree 0 to 3, found 8"),
        ] {
            let error = read_file(&without(name), "").unwrap_err().to_string();
            assert!(error.starts_with("s.ply: header: expected") && error.contains(expected), "{error}");
        }
        let text = b"ply\nformat binary_little_endian 1.0\nelement face 0\nend_header\n";
        let error = read(Path::new("s.ply"), text).unwrap_err().to_string();
        assert!(error.contains("an element `vertex`, found elements `face`"), "{error}");
    }
}
