//! The page: data, scripts and words in one file that opens from disk, whatever the kind of the model.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use serde_json::{Value, json};

use octobayes::geometry::{Aabb, Camera, Distortion, Domain, upright};
use octobayes::io::AtomicFile;
use octobayes::posterior::Scale;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};
use octobayes_data::Frame;
use octobayes_depth::{DEPTH_JUMP, FieldFactors, NINETY};

const PAGE: &str = include_str!("web/page.html");
const STYLE: &str = include_str!("web/style.css");
/// The scripts that both kinds of model share: those before the model's own, and those after.
const BEFORE: [&str; 3] = [include_str!("web/data.js"), include_str!("web/space.js"), include_str!("web/renderer.js")];
const AFTER: [&str; 6] = [
    include_str!("web/camera.js"),
    include_str!("web/overlay.js"),
    include_str!("web/measure.js"),
    include_str!("web/panel.js"),
    include_str!("web/input.js"),
    include_str!("web/main.js"),
];
/// What layers show of a pixel.
const LAYERS: &str = include_str!("web/layers.glsl");
/// Bars of the histogram.
const BARS: usize = 48;
/// Most cameras in the file.
const CAMERAS: usize = 1000;

/// What a page shows beside the model.
pub struct Page<'a> {
    /// The model's uncertainty.
    pub field: &'a UncertaintyField,
    /// The training cameras.
    pub frames: &'a [Frame],
    /// Cameras of photographs that are to be added.
    pub planned: &'a [Frame],
    /// Where in a pixel rays pass.
    pub offset: f64,
    /// Colour behind the model.
    pub background: Vec3,
    /// Points on visible surfaces, for the histogram.
    pub surface: &'a [Vec3],
    /// Ends of the colour bar of log10 U.
    pub range: [f64; 2],
    /// Name of the model, for people.
    pub title: &'a str,
    /// Units of lengths that people read, for a scene unit, and their name.
    pub unit: (f64, &'a str),
}

/// What the page of one kind of model holds beside what all pages hold.
pub struct Parts<'a> {
    /// Its scripts: the model, and how it is drawn.
    pub scripts: &'a [&'a str],
    /// Its shaders and data, each with the name by which scripts find it.
    pub data: &'a [(&'a str, &'a str)],
    /// Numbers and names that scripts read, an object.
    pub about: Value,
    /// Whether the model is a volume.
    pub is_volume: bool,
}

impl Page<'_> {
    /// The page as text.
    #[must_use]
    pub fn text(&self, bounds: [Aabb; 2], parts: &Parts) -> String {
        let mut about = self.about(bounds, parts.is_volume);
        let members = about.as_object_mut().expect("an object is made");
        members.extend(parts.about.as_object().expect("parts are an object").clone());
        // `</script>` in a name would end the data.
        let about = about.to_string().replace('<', "\\u003c");
        let scripts = [&BEFORE[..], parts.scripts, &AFTER].concat().join("\n");
        let title = self.title.replace('&', "&amp;").replace('<', "&lt;");
        let element =
            |(name, text): &(&str, &str)| format!("<script type=\"text/plain\" id=\"{name}\">{text}</script>\n");
        let data: String = [("layers", LAYERS)].iter().chain(parts.data).map(element).collect();
        let marks: [(&str, &str); 5] = [
            ("{{TITLE}}", &title),
            ("{{STYLE}}", STYLE),
            ("{{ABOUT}}", &about),
            ("{{DATA}}", &data),
            ("{{SCRIPTS}}", &scripts),
        ];
        // Piece by piece: what is filled in is not searched.
        let (mut out, mut rest) = (String::with_capacity(data.len() + 200_000), PAGE);
        for (mark, text) in marks {
            let (before, after) = rest.split_once(mark).expect("the page has every mark, in this order");
            out.push_str(before);
            out.push_str(text);
            rest = after;
        }
        out + rest
    }

    /// What all pages hold of a model that lies in the first box, and nearly all of it in the second.
    fn about(&self, [bounds, core]: [Aabb; 2], is_volume: bool) -> Value {
        let field = self.field;
        let contraction = match field.lattice().domain() {
            Domain::Contracted { center, radius, norm } => {
                json!({ "center": center, "radius": radius, "norm": norm.name() })
            }
            _ => Value::Null,
        };
        let map = |gradient: colorous::Gradient| -> Vec<[u8; 3]> {
            (0..256).map(|i| gradient.eval_rational(i, 256).as_array()).collect()
        };
        let spacing = self.frames.len().div_ceil(CAMERAS).max(1);
        let camera = |is_planned: bool, index: usize, frame: &Frame| {
            let Camera { position, axes, focal, center, resolution, distortion } = frame.camera;
            json!({
                "index": index, "name": frame.name, "position": position.to_array(), "axes": axes.to_cols_array(),
                "focal": focal, "center": center, "resolution": resolution,
                "isDistorted": distortion != Distortion::default(), "isPlanned": is_planned,
            })
        };
        let taken = self.frames.iter().enumerate().step_by(spacing).map(|(k, frame)| camera(false, k, frame));
        let shown = taken.chain(self.planned.iter().enumerate().map(|(k, frame)| camera(true, k, frame)));
        let cameras: Vec<Camera> = self.frames.iter().map(|frame| frame.camera).collect();
        // A page has keys to turn freely.
        let up = upright(&cameras, None).unwrap_or(DVec3::Z);
        let found = field.query_all(self.surface);
        let known: Vec<f64> = found.iter().map(|found| found.uncertainty.log10()).collect();
        let deviation = FieldFactors::new(field, is_volume).map(|FieldFactors { factor, cells, cell, pixel_angle }| {
            json!({
                "factor": factor, "cells": cells, "cell": cell, "pixelAngle": pixel_angle, "jump": DEPTH_JUMP,
                "ninety": NINETY,
            })
        });
        let ends = |of: Aabb| json!({ "min": of.min().to_array(), "max": of.max().to_array() });
        json!({
            "title": self.title,
            "unit": { "factor": self.unit.0, "name": self.unit.1 },
            "deviation": deviation,
            "contraction": contraction,
            "bounds": ends(bounds),
            "core": ends(core),
            "up": up.to_array(),
            "knowsUnseen": field.ray_coverage().is_some(),
            "quantity": field.record().scale.quantity(),
            "isLength": matches!(field.record().scale, Scale::Data(_)),
            "prior": field.prior().log10(),
            "range": self.range,
            "histogram": histogram(&known, [self.range[0], field.prior().log10()]),
            "background": self.background.to_array(),
            "pixelOffset": self.offset,
            "maps": { "uncertainty": map(colorous::INFERNO), "depth": map(colorous::VIRIDIS) },
            "cameras": shown.collect::<Vec<_>>(),
        })
    }
}

/// Writes a page: the file appears complete or not at all.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, page: &str) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(page.as_bytes()).map_err(Error::io(path, "cannot write"))?;
    file.commit()
}

/// Numbers of surface points by log10 U, from the lower end of the colour bar to the prior.
fn histogram(known: &[f64], [low, prior]: [f64; 2]) -> Vec<u64> {
    let mut bars = vec![0; BARS];
    for log10 in known {
        let share = (log10 - low) / (prior - low);
        bars[((share * BARS as f64).max(0.0) as usize).min(BARS - 1)] += 1;
    }
    bars
}

#[cfg(test)]
pub mod tests {
    /// The page has as many ends as scripts, whatever its data, and every mark is filled in.
    pub fn check(page: &str) {
        assert_eq!(page.matches("</script>").count(), page.matches("<script ").count());
        assert!(!page.contains("{{"), "every mark is filled in");
    }
}
