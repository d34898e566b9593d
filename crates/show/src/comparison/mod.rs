//! A page that shows views before and after, at several strengths of what is done to them.
//!
//! All images are made beforehand: the page needs no model, no WebGL and no network, and opens from disk.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use octobayes::io::AtomicFile;
use octobayes::{Error, Result};
use serde_json::{Value, json};

const PAGE: &str = include_str!("page.html");
/// Quality of the images, of 100.
const QUALITY: u8 = 88;

/// What the page shows.
#[derive(Debug, Clone)]
pub struct Comparison<'a> {
    /// Name of the model, for people.
    pub title: &'a str,
    /// The strengths, weakest first.
    pub steps: Vec<Step>,
    /// The strength that is shown first.
    pub first: usize,
    /// Colours of marks, as CSS writes them, and their meanings.
    pub legend: Vec<[String; 2]>,
    /// The views.
    pub views: Vec<ComparedView>,
}

/// One strength.
#[derive(Debug, Clone)]
pub struct Step {
    /// Its name.
    pub name: String,
    /// What it does, lines of text.
    pub lines: Vec<String>,
}

/// A view.
#[derive(Debug, Clone)]
pub struct ComparedView {
    /// Its name.
    pub name: String,
    /// Before anything is done.
    pub before: RgbImage,
    /// `[steps]`: what is done is marked, and after it.
    pub steps: Vec<[RgbImage; 2]>,
}

impl Comparison<'_> {
    /// The page as text.
    ///
    /// # Errors
    /// If an image cannot be encoded.
    pub fn text(&self) -> Result<String> {
        let view = |view: &ComparedView| -> Result<Value> {
            let steps = view.steps.iter().map(|step| Ok(json!([data_url(&step[0])?, data_url(&step[1])?])));
            let steps: Vec<Value> = steps.collect::<Result<_>>()?;
            Ok(json!({ "name": view.name, "before": data_url(&view.before)?, "steps": steps }))
        };
        let views: Vec<Value> = self.views.iter().map(view).collect::<Result<_>>()?;
        let steps: Vec<Value> = self.steps.iter().map(|s| json!({ "name": s.name, "lines": s.lines })).collect();
        let data = json!({ "steps": steps, "first": self.first, "legend": self.legend, "views": views });
        // `</script>` in a name would end the data.
        let data = data.to_string().replace('<', "\\u003c");
        let title = self.title.replace('&', "&amp;").replace('<', "&lt;");
        Ok(PAGE.replace("{{TITLE}}", &title).replace("{{DATA}}", &data))
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If an image cannot be encoded, or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        AtomicFile::write(path, self.text()?.as_bytes())
    }
}

pub(crate) fn data_url(image: &RgbImage) -> Result<String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, QUALITY)
        .encode_image(image)
        .map_err(|e| Error::setting("image of a page", "one that JPEG can hold", e.to_string()))?;
    Ok(format!("data:image/jpeg;base64,{}", STANDARD.encode(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_every_image_and_nothing_from_elsewhere() {
        let image = |v: u8| RgbImage::from_pixel(4, 3, image::Rgb([v; 3]));
        let step = |name: &str| Step { name: name.into(), lines: vec!["</script><b>".into()] };
        let view = |k: u8| ComparedView {
            name: format!("view {k}"),
            before: image(k),
            steps: vec![[image(k + 1), image(k + 2)], [image(k + 3), image(k + 4)]],
        };
        let page = Comparison {
            title: "a <b> & c",
            steps: vec![step("little"), step("much")],
            first: 1,
            legend: vec![["rgb(1, 2, 3)".into(), "floating".into()]],
            views: vec![view(10), view(100)],
        };
        let text = page.text().unwrap();
        assert!(text.contains("<title>a &lt;b> &amp; c") && !text.contains("{{"), "{}", &text[..400]);
        // One tag ends the data, one the script.
        assert_eq!(text.matches("</script>").count(), 2);
        assert!(!text.contains("http://") && !text.contains("https://"));
        let data = text.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
        let data: Value = serde_json::from_str(data).unwrap();
        assert_eq!((&data["first"], data["steps"].as_array().unwrap().len()), (&json!(1), 2));
        let mut levels = Vec::new();
        for view in data["views"].as_array().unwrap() {
            let steps = view["steps"].as_array().unwrap().iter().flat_map(|step| step.as_array().unwrap());
            for url in std::iter::once(&view["before"]).chain(steps) {
                let bytes =
                    STANDARD.decode(url.as_str().unwrap().trim_start_matches("data:image/jpeg;base64,")).unwrap();
                let found = image::load_from_memory(&bytes).unwrap().to_rgb8();
                assert_eq!(found.dimensions(), (4, 3));
                levels.push(found.get_pixel(2, 1).0[0]);
            }
        }
        let expected: Vec<u8> = [10_u8, 100].iter().flat_map(|k| *k..k + 5).collect();
        // A plain image loses at most a step or two.
        assert!(levels.iter().zip(&expected).all(|(a, b)| a.abs_diff(*b) <= 2), "{levels:?}");
    }
}
