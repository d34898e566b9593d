//! The `cameras.xml` that Metashape exports (File > Export > Export Cameras, Agisoft XML), as frames of a
//! transforms.json.
//!
//! A camera's `transform` is camera-to-chunk, row by row: x right, y down, z forward. The chunk, or the component that
//! the camera is of, has a similarity to the world. A sensor's calibration has f, cx, cy, b1 and b2 in pixels of its
//! `resolution`, cx and cy from the middle of the image:
//! u = w/2 + cx + (f + b1) x' + b2 y', v = h/2 + cy + f y' (Metashape's manual, appendix on camera models). Radial
//! coefficients are OpenCV's polynomial; its P1 is OpenCV's p2, and its P2 is p1.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DMat4, DVec3, DVec4};
use roxmltree::{Document, Node};
use serde_json::{Map, Value, json};

use octobayes::{Error, Result};

/// A lens as keys of a transforms.json.
type Lens = Map<String, Value>;

/// Whether text is such a file, or another XML.
pub(super) fn is_xml(text: &str) -> bool {
    text.trim_start_matches('\u{feff}').trim_start().starts_with('<')
}

/// The cameras of a file as a transforms.json. A note counts those that were not aligned or are switched off.
///
/// # Errors
/// If the text is no XML, if it holds no aligned camera, if a number is missing or wrong, or if a lens is none that
/// rays are known of.
pub(super) fn as_transforms(path: &Path, text: &str) -> Result<(Value, Option<String>)> {
    let document = Document::parse(text.trim_start_matches('\u{feff}')).map_err(|e| {
        let place = format!("line {}, column {}", e.pos().row, e.pos().col);
        Error::malformed(path, place, "XML", e.to_string())
    })?;
    let chunk = document.descendants().find(|node| node.has_tag_name("chunk"));
    let cameras = chunk.and_then(|chunk| child(chunk, "cameras"));
    let (Some(chunk), Some(cameras)) = (chunk, cameras) else {
        let expected = "a transforms.json, a COLMAP model, or the cameras.xml of Metashape, with a chunk of cameras";
        return Err(Error::malformed(path, "cameras", expected, "another XML"));
    };
    let file = File { path };
    let mut lenses = HashMap::new();
    for sensor in children(chunk, "sensors", "sensor") {
        let id = sensor.attribute("id").unwrap_or_default();
        lenses.insert(id, file.lens(sensor));
    }
    let mut worlds = HashMap::new();
    for component in children(chunk, "components", "component") {
        if let Some(transform) = child(component, "transform") {
            worlds.insert(component.attribute("id").unwrap_or_default(), file.similarity(transform)?);
        }
    }
    let of_chunk = child(chunk, "transform").map(|transform| file.similarity(transform)).transpose()?;
    let (mut frames, mut left_out) = (Vec::new(), 0);
    // Cameras may stand in groups.
    for camera in cameras.descendants().filter(|node| node.has_tag_name("camera")) {
        let label = camera.attribute("label").unwrap_or("?");
        let is_off = camera.attribute("enabled").is_some_and(|on| ["0", "false"].contains(&on));
        let Some(transform) = child(camera, "transform").filter(|_| !is_off) else {
            left_out += 1;
            continue;
        };
        let place = format!("camera `{label}`");
        let pose = file.numbers::<16>(transform, &place)?;
        let [x, y, z, w] = [0, 1, 2, 3].map(|k| DVec4::new(pose[k], pose[4 + k], pose[8 + k], pose[12 + k]));
        let component = camera.attribute("component_id").and_then(|id| worlds.get(id));
        let world = component.or(of_chunk.as_ref()).copied().unwrap_or(DMat4::IDENTITY);
        let matrix = world * DMat4::from_cols(x, -y, -z, w);
        let sensor = camera.attribute("sensor_id").unwrap_or_default();
        let lens = match lenses.get(sensor) {
            Some(Ok(lens)) => lens,
            // Sensors without aligned cameras may be of any kind.
            Some(Err((expected, found))) => {
                return Err(Error::malformed(path, format!("sensor {sensor}, of {place}"), *expected, found.clone()));
            }
            None => return Err(Error::malformed(path, place, "a `sensor_id` of one of the sensors", sensor)),
        };
        let mut frame = lens.clone();
        frame.insert("file_path".into(), json!(label));
        let row = |k: usize| matrix.row(k).to_array();
        frame.insert("transform_matrix".into(), json!([row(0), row(1), row(2), row(3)]));
        frames.push(Value::Object(frame));
    }
    if frames.is_empty() {
        let found = format!("none; {left_out} are not aligned, or are switched off");
        return Err(Error::malformed(path, "cameras", "at least one aligned camera, with a `transform`", found));
    }
    let note = (left_out > 0).then(|| {
        format!(
            "{left_out} of {} cameras are not aligned, or are switched off, and are left out",
            frames.len() + left_out
        )
    });
    Ok((json!({ "frames": frames }), note))
}

/// What names the file in errors.
struct File<'a> {
    path: &'a Path,
}

impl File<'_> {
    /// The numbers that an element holds.
    fn numbers<const N: usize>(&self, node: Node, place: &str) -> Result<[f64; N]> {
        let text = node.text().unwrap_or_default();
        let numbers: Vec<f64> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let is_whole = numbers.len() == text.split_whitespace().count() && numbers.iter().all(|v| v.is_finite());
        let found = || {
            Error::malformed(
                self.path,
                format!("{place}, <{}>", node.tag_name().name()),
                format!("{N} finite numbers"),
                octobayes::error::printable(text.trim()),
            )
        };
        <[f64; N]>::try_from(numbers).ok().filter(|_| is_whole).ok_or_else(found)
    }

    /// From the chunk, or a component, to the world.
    fn similarity(&self, transform: Node) -> Result<DMat4> {
        let place = "the chunk's transform";
        let rotation = child(transform, "rotation").map(|node| self.numbers::<9>(node, place)).transpose()?;
        let rotation = rotation.map_or(DMat3::IDENTITY, |rows| DMat3::from_cols_array(&rows).transpose());
        let shift = child(transform, "translation").map(|node| self.numbers::<3>(node, place)).transpose()?;
        let scale = child(transform, "scale").map(|node| self.numbers::<1>(node, place)).transpose()?;
        let scale = scale.map_or(1.0, |[scale]| scale);
        Ok(DMat4::from_translation(shift.map_or(DVec3::ZERO, DVec3::from)) * DMat4::from_mat3(scale * rotation))
    }

    /// The lens of a sensor; what was expected and found if rays are not known of it.
    fn lens(&self, sensor: Node) -> std::result::Result<Lens, (&'static str, String)> {
        const PERSPECTIVE: &str = "a `frame` lens; export undistorted images with their cameras for others (Metashape: \
                                   Convert Images, or Export Cameras in COLMAP's format)";
        let calibrations = || sensor.children().filter(|node| node.has_tag_name("calibration"));
        let adjusted = calibrations().find(|node| node.attribute("class") == Some("adjusted"));
        let Some(calibration) = adjusted.or_else(|| calibrations().next()) else {
            return Err(("a calibration", "none".into()));
        };
        for node in [sensor, calibration] {
            match node.attribute("type") {
                None | Some("frame") => {}
                Some(kind) => return Err((PERSPECTIVE, format!("`{kind}`"))),
            }
        }
        let resolution = child(calibration, "resolution").or_else(|| child(sensor, "resolution"));
        let side = |name: &str| resolution.and_then(|node| node.attribute(name)?.parse::<f64>().ok());
        let (Some(w), Some(h)) = (side("width"), side("height")) else {
            return Err(("a resolution with width and height", "none".into()));
        };
        let value = |name: &str| -> std::result::Result<Option<f64>, (&'static str, String)> {
            let Some(node) = child(calibration, name) else { return Ok(None) };
            let text = node.text().unwrap_or_default().trim();
            let number = text.parse::<f64>().ok().filter(|v| v.is_finite());
            number.map(Some).ok_or_else(|| ("finite numbers in the calibration", format!("<{name}> {text}")))
        };
        let known = |name: &str| Ok::<f64, (&'static str, String)>(value(name)?.unwrap_or(0.0));
        // Older files have focal lengths along both axes, and the centre from the corner.
        let f = match (value("f")?, value("fx")?, value("fy")?) {
            (Some(f), None, None) if f > 0.0 => f,
            (f, fx, fy) => {
                let found = [("f", f), ("fx", fx), ("fy", fy)];
                let found = found.into_iter().filter_map(|(name, v)| Some(format!("{name} {}", v?)));
                return Err(("a focal length f above 0, in pixels", found.collect::<Vec<_>>().join(", ")));
            }
        };
        for name in ["b2", "p3", "p4"] {
            let value = known(name)?;
            if value != 0.0 {
                return Err((
                    "a lens without b2, p3 and p4; align again without them, or export undistorted images",
                    format!("{name} {value}"),
                ));
            }
        }
        let lens = json!({
            "camera_model": "OPENCV", "w": w, "h": h, "fl_x": f + known("b1")?, "fl_y": f,
            "cx": 0.5 * w + known("cx")?, "cy": 0.5 * h + known("cy")?,
            "k1": known("k1")?, "k2": known("k2")?, "k3": known("k3")?, "k4": known("k4")?,
            "p1": known("p2")?, "p2": known("p1")?,
        });
        match lens {
            Value::Object(lens) => Ok(lens),
            _ => unreachable!("an object was made"),
        }
    }
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn children<'a, 'i>(node: Node<'a, 'i>, list: &str, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    child(node, list).into_iter().flat_map(move |list| list.children().filter(move |child| child.has_tag_name(name)))
}

#[cfg(test)]
mod tests;
