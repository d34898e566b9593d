//! `.ply` of the original code, with any properties in any order.

mod write;

use std::path::Path;

use glam::{Vec3, Vec4};

use super::super::columns::{Effect, Extra, Field, Layout, Packing, Scalar};
use super::super::{RenderMode, Splats, coefficients};
use super::header::{Element, Ply, Property, parse};
use super::raw::Raw;
use super::{compressed, constant_of};
use octobayes::{Error, Result};

/// The header's comment that states the [`RenderMode`].
const MODE: &str = "SplatRenderMode:";
/// The header's comment beside mode `mip` that states by which variance splats grow, if it is not 0.3 px².
const DILATION: &str = "SplatDilation:";
/// The same of Postshot: 1 for mip, 0 for classic.
const ANTIALIASED: &str = "antialiased";
/// What CloudCompare puts before the names of properties that it does not know, once more whenever it saves a file.
const PREFIX: &str = "scalar_";
/// Colours in place of the constant coefficients, as `ns-export --ply-color-mode rgb` writes them.
const COLORS: [&str; 3] = ["red", "green", "blue"];
/// Names that a note lists at most.
const MAX_LISTED: usize = 8;

/// Reads the bytes of a PLY file, compressed or not.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Splats> {
    let mut ply = parse(path, bytes)?;
    let mode = mode_of(path, &mut ply.comments)?;
    let Some(vertex) = ply.elements.iter().position(|element| element.name == "vertex") else {
        let names: Vec<String> = ply.elements.iter().map(|element| format!("`{}`", element.name)).collect();
        return Err(Error::malformed(path, "header", "an element `vertex`", format!("elements {}", names.join(", "))));
    };
    if ply.elements[vertex].property("packed_position").is_some() {
        return compressed::read(path, &ply, mode.unwrap_or_default());
    }
    let mut notes = Vec::new();
    check_color_space(path, &ply, &mut notes)?;
    let (mut layout, degree) = layout(path, &ply.elements[vertex], ply.comments)?;
    let unknown: Vec<&str> =
        layout.extras.iter().filter(|extra| Effect::of(&extra.name).is_none()).map(|extra| &*extra.name).collect();
    if !unknown.is_empty() {
        let more = if unknown.len() > MAX_LISTED { ", …" } else { "" };
        let names = unknown[..unknown.len().min(MAX_LISTED)].join(", ");
        notes.push(format!(
            "properties without a known meaning are kept, and do not change what is drawn: {names}{more}"
        ));
    }
    let mut raw = numbers(path, &ply.elements[vertex], &layout, degree, mode.unwrap_or_default())?;
    // A file with this filter is of Mip-Splatting or of a code that builds on it.
    if let Some(filter) = layout.take(Effect::Filter) {
        raw.mode = mode.unwrap_or(RenderMode::MipSplatting);
        raw.filter(|i| filter.number(i));
        notes.push(format!(
            "`{}` of Mip-Splatting is applied to scales and opacities; splats are drawn in mode `{}` unless \
             --splat-mode sets another",
            filter.name, raw.mode
        ));
    }
    raw.finish(path, Some(layout), notes)
}

/// Takes the render mode out of the comments. The last one counts.
fn mode_of(path: &Path, comments: &mut Vec<String>) -> Result<Option<RenderMode>> {
    let mut mode = None;
    let is_stated = |comment: &mut String| {
        let antialiased = comment.strip_prefix(ANTIALIASED).is_some_and(|rest| [" 0", " 1"].contains(&rest.trim_end()));
        antialiased || [MODE, DILATION].iter().any(|key| comment.trim_start().starts_with(key))
    };
    for comment in comments.extract_if(.., is_stated) {
        let (key, value) = comment.trim().split_once([':', ' ']).unwrap_or_default();
        let value = value.trim();
        mode = Some(match (key, value) {
            ("SplatRenderMode", "mip") | ("antialiased", "1") => RenderMode::Mip,
            ("SplatRenderMode", "default" | "classic") | ("antialiased", "0") => RenderMode::Classic,
            ("SplatDilation", "0.1") if mode == Some(RenderMode::Mip) => RenderMode::MipSplatting,
            (key, _) => {
                let expected = if key == "SplatDilation" { "`0.1` after mode `mip`" } else { "`mip` or `default`" };
                let place = format!("header, comment `{key}:`");
                return Err(Error::malformed(path, place, expected, format!("`{value}`")));
            }
        });
    }
    Ok(mode)
}

/// Refuses colours in linear light, which SHARP's element marks with 1: pictures of them would be too dark.
fn check_color_space(path: &Path, ply: &Ply, notes: &mut Vec<String>) -> Result<()> {
    let is_beside = |element: &&Element| element.name != "vertex" && element.count > 0 && !element.has_lists();
    let mut beside = ply.elements.iter().filter(is_beside);
    let stated = beside.find_map(|element| Some((element, element.property("color_space")?)));
    let Some((element, space)) = stated else { return Ok(()) };
    let number = space.number(&element.rows[..element.stride]);
    if number != 0.0 {
        let expected = "colours in sRGB, 0 (ml-sharp's `save_ply` writes them)";
        return Err(Error::malformed(path, "`color_space`", expected, format!("{number}, linear light")));
    }
    let note = "the file is SHARP's, whose own renderer blends colours in linear light; here they are blended in sRGB";
    notes.push(note.into());
    Ok(())
}

/// The names of properties as other programs have them: without CloudCompare's prefix.
fn names_of(vertex: &Element) -> Vec<String> {
    let plain = |property: &Property| match property.name.trim_start_matches(PREFIX) {
        "" => property.name.clone(),
        name if vertex.property(name).is_some() => property.name.clone(),
        name => name.to_string(),
    };
    vertex.properties.iter().map(plain).collect()
}

/// The meaning of all properties, and the degree that follows from their number.
fn layout(path: &Path, vertex: &Element, comments: Vec<String>) -> Result<(Layout, u8)> {
    let names = names_of(vertex);
    let has = |name: &str| names.iter().any(|other| other == name);
    let is_colored = ["opacity", "scale_0", "rot_0"].iter().all(|name| has(name)) && !has("f_dc_0");
    let named = |name: &str| {
        let color = COLORS.iter().position(|color| *color == name).filter(|_| is_colored);
        color.map(Field::Constant).or_else(|| Field::named(name))
    };
    let others: Vec<&str> = names.iter().filter(|name| named(name).is_none()).map(String::as_str).collect();
    if let Some((name, what)) = Effect::first_change(&others) {
        let expected = "splats that are drawn by their parameters alone (if these are, remove the property)";
        return Err(Error::malformed(path, "header", expected, format!("`{name}`: {what}")));
    }
    let mut extras = Vec::new();
    let mut meaning = |(name, property): (&String, &Property)| {
        named(name).unwrap_or_else(|| {
            let bytes = vertex.rows.chunks_exact(vertex.stride).flat_map(|row| property.of(row)).copied().collect();
            extras.push(Extra { name: name.clone(), kind: property.kind, bytes });
            Field::Extra(extras.len() - 1)
        })
    };
    let order: Vec<Field> = names.iter().zip(&vertex.properties).map(&mut meaning).collect();
    let rest = order.iter().filter(|field| matches!(field, Field::Rest(_))).count();
    let Some(degree) = (0..=super::super::MAX_DEGREE).find(|degree| 3 * (coefficients(*degree) - 1) == rest) else {
        let expected = "0, 9, 24 or 45 properties `f_rest_…`, spherical harmonics of degree 0 to 3";
        return Err(Error::malformed(path, "header", expected, rest.to_string()));
    };
    if let Some(missing) = Field::all(degree).into_iter().find(|field| !order.contains(field)) {
        let name = missing.name(&[]);
        let hint = match missing {
            Field::Scale(2) => " (2D splats have no third scale; only 3D splats are read)",
            Field::Constant(_) if !has("opacity") => " (points with colours are no splats)",
            _ => "",
        };
        return Err(Error::malformed(path, "header", format!("a property `{name}`{hint}"), names.join(" ")));
    }
    Ok((Layout { order, extras, comments, packing: Packing::None }, degree))
}

/// The parameters of all rows.
fn numbers(path: &Path, vertex: &Element, layout: &Layout, degree: u8, mode: RenderMode) -> Result<Raw> {
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
            let mut number = property.number(row);
            let entry = match *field {
                Field::Mean(axis) => &mut raw.means[i][axis],
                Field::Scale(axis) => &mut raw.log_scales[i][axis],
                // The file begins with w.
                Field::Rotation(entry) => &mut raw.rotations[i][(entry + 3) % 4],
                Field::Opacity => &mut raw.opacity_logits[i],
                Field::Constant(channel) => {
                    if property.name.ends_with(COLORS[channel]) {
                        number = constant_of(color(path, property, i, number)?).into();
                    }
                    &mut raw.sh[i * 3 * k + channel]
                }
                Field::Rest(entry) => &mut raw.sh[i * 3 * k + place_of_rest(entry, k)],
                Field::Extra(_) => continue,
            };
            *entry = number as f32;
        }
    }
    Ok(raw)
}

/// A colour from 0 to 1. Whole numbers are parts of the largest one of 8 or 16 bits.
fn color(path: &Path, property: &Property, i: usize, number: f64) -> Result<f64> {
    let value = match property.kind {
        Scalar::U8 => number / f64::from(u8::MAX),
        Scalar::U16 => number / f64::from(u16::MAX),
        _ => number,
    };
    if value <= 1.0 || !value.is_finite() {
        return Ok(value);
    }
    let expected = "a colour up to 1, or of type `uchar` or `ushort`";
    Err(Error::malformed(path, format!("splat {i}, `{}`", property.name), expected, number.to_string()))
}

/// Where `f_rest_[entry]` belongs among the `3 k` coefficients of a splat.
pub(super) const fn place_of_rest(entry: usize, k: usize) -> usize {
    let (channel, higher) = (entry / (k - 1), entry % (k - 1));
    3 * (1 + higher) + channel
}

#[cfg(test)]
mod tests;
