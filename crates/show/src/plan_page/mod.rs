//! A page that says which photographs to add: a map, and a card for each with what it would see and how to get there.
//! It needs no script and no network, and opens from disk.

mod map;

use std::fmt::Write as _;
use std::path::Path;

use image::RgbImage;
use octobayes::Result;
use octobayes::io::AtomicFile;

use crate::comparison::data_url;
use crate::depth_page::escaped;

pub use map::{Mark, PlanMap};

const PAGE: &str = include_str!("page.html");
/// The element that holds the planned cameras as a transforms.json.
const CAMERAS: &str = "<script type=\"application/json\" id=\"cameras\">";
const END: &str = "</script>";

/// What the page shows.
#[derive(Debug, Clone)]
pub struct PlanPage<'a> {
    /// Name of the model, for people.
    pub title: &'a str,
    /// Paragraphs.
    pub lead: Vec<String>,
    /// The scene from above, and from the side.
    pub maps: Vec<PlanMap>,
    /// The photographs, in the order in which to take them.
    pub views: Vec<PlannedView>,
    /// Their cameras, the text of a transforms.json.
    pub cameras: String,
}

/// A photograph to take.
#[derive(Debug, Clone)]
pub struct PlannedView {
    /// What it is called.
    pub name: String,
    /// How to get there, and what it is worth.
    pub lines: Vec<String>,
    /// What it would see, and the nearest photograph that there is, each with its caption.
    pub images: Vec<(String, RgbImage)>,
}

impl PlanPage<'_> {
    /// The page as text.
    ///
    /// # Errors
    /// If an image cannot be encoded.
    pub fn text(&self) -> Result<String> {
        let lead: String = self.lead.iter().map(|text| format!("<p>{}</p>\n", escaped(text))).collect();
        let maps = self.maps.iter().map(PlanMap::svg).collect::<Result<Vec<_>>>()?.concat();
        let mut views = String::new();
        for (k, view) in self.views.iter().enumerate() {
            let lines: String = view.lines.iter().map(|line| format!("<p>{}</p>\n", escaped(line))).collect();
            let image = |(caption, image): &(String, RgbImage)| {
                let caption = escaped(caption);
                let (url, [width, height]) = (data_url(image)?, [image.width(), image.height()]);
                Ok(format!(
                    "<figure><img src=\"{url}\" alt=\"{caption}\" width=\"{width}\" height=\"{height}\">\
                     <figcaption>{caption}</figcaption></figure>"
                ))
            };
            let images = view.images.iter().map(image).collect::<Result<Vec<_>>>()?.concat();
            let name = escaped(&view.name);
            let _ = writeln!(
                views,
                "<section><h2><span class=\"number\">{}</span> {name}</h2>{lines}<div class=\"images\">{images}</div></section>",
                k + 1
            );
        }
        // `</script>` in a name would end the data.
        let cameras = self.cameras.replace('<', "\\u003c");
        // The data last, so that nothing in the other texts is taken for a place of it.
        Ok(PAGE
            .replace("{{LEAD}}", &lead)
            .replace("{{MAPS}}", &maps)
            .replace("{{VIEWS}}", &views)
            .replace("{{TITLE}}", &escaped(self.title))
            .replace("{{CAMERAS}}", &format!("{CAMERAS}{cameras}{END}")))
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If an image cannot be encoded, or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        AtomicFile::write(path, self.text()?.as_bytes())
    }
}

/// The cameras of a page's plan, the text of a transforms.json; `None` if it is no such page.
#[must_use]
pub fn planned_cameras(page: &str) -> Option<&str> {
    page.split_once(CAMERAS)?.1.split_once(END).map(|(cameras, _)| cameras)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_all_views_and_its_cameras() {
        let image = |v: u8| RgbImage::from_pixel(4, 3, image::Rgb([v; 3]));
        let view = |k: u8| PlannedView {
            name: format!("view <{k}>"),
            lines: vec!["1 m to the left of {{CAMERAS}}".into()],
            images: vec![("what it would see".into(), image(k)), ("IMG_1 & 2".into(), image(k + 1))],
        };
        let cameras = r#"{"frames": [{"file_path": "</script><b>"}]}"#;
        let page = PlanPage {
            title: "a <b>",
            lead: vec!["two of 60".into()],
            maps: Vec::new(),
            views: vec![view(10), view(100)],
            cameras: cameras.into(),
        };
        let text = page.text().unwrap();
        assert!(text.contains("<title>a &lt;b>") && text.contains("view &lt;100>") && text.contains("IMG_1 &amp; 2"));
        assert_eq!((text.matches("<section>").count(), text.matches("<img ").count()), (2, 4));
        assert_eq!(text.matches("</script>").count(), 1, "one element holds data");
        assert!(!text.contains("http://") && !text.contains("https://"), "nothing from elsewhere");
        let found: serde_json::Value = serde_json::from_str(planned_cameras(&text).unwrap()).unwrap();
        assert_eq!(found, serde_json::from_str::<serde_json::Value>(cameras).unwrap());
        assert_eq!(planned_cameras("<html></html>"), None);
    }
}
