//! A page on depths and how far they may be off, for people who want no numbers of pixels. It needs no script and no
//! network, and opens from disk.

use std::fmt::Write as _;
use std::path::Path;

use image::RgbImage;
use octobayes::Result;
use octobayes::io::AtomicFile;

use crate::comparison::data_url;

const PAGE: &str = include_str!("page.html");

/// What the page shows.
#[derive(Debug, Clone)]
pub struct DepthPage<'a> {
    /// Name of the model, for people.
    pub title: &'a str,
    /// Paragraphs.
    pub lead: Vec<String>,
    /// Shares of what photographs show with their names and colours, as CSS writes them.
    pub shares: Vec<(String, f64, &'a str)>,
    /// The unit of lengths.
    pub unit: &'a str,
    /// Deviations: the lower ends of classes, a factor of the same ratio apart, with the pixels of each.
    pub histogram: Vec<(f64, u64)>,
    /// The least certain places.
    pub places: Vec<Place>,
    /// Head and rows of a table.
    pub table: (Vec<String>, Vec<Vec<String>>),
}

/// A place.
#[derive(Debug, Clone)]
pub struct Place {
    /// What it is, and what would help.
    pub text: String,
    /// Pictures of it.
    pub images: Vec<RgbImage>,
}

impl DepthPage<'_> {
    /// The page as text.
    ///
    /// # Errors
    /// If an image cannot be encoded.
    pub fn text(&self) -> Result<String> {
        let mut lead: String = self.lead.iter().map(|text| format!("<p>{}</p>\n", escaped(text))).collect();
        let bars = self.shares.iter().map(|(name, share, color)| {
            format!(
                "<span style=\"width:{:.2}%;background:{color}\" title=\"{}\"></span>",
                100.0 * share,
                escaped(name)
            )
        });
        let keys = self.shares.iter().map(|(name, share, color)| {
            let name = escaped(name);
            format!("<span class=\"key\" style=\"background:{color}\"></span>{name} {:.1} %", 100.0 * share)
        });
        if !self.shares.is_empty() {
            let (bars, keys): (String, String) = (bars.collect(), keys.collect());
            let _ = write!(lead, "<div class=\"bar\">{bars}</div>\n<p>{keys}</p>\n");
        }
        let mut places = String::new();
        for place in &self.places {
            let images = place.images.iter().map(|image| Ok(format!("<img src=\"{}\" alt=\"\">", data_url(image)?)));
            let images: String = images.collect::<Result<Vec<_>>>()?.concat();
            let _ = writeln!(places, "<figure><figcaption>{}</figcaption>{images}</figure>", escaped(&place.text));
        }
        let (head, rows) = &self.table;
        let cells = |row: &[String], tag: &str| -> String {
            let cells: String = row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
            format!("<tr>{cells}</tr>\n")
        };
        let rows: String = rows.iter().map(|row| cells(row, "td")).collect();
        let table = format!("<table>\n{}{rows}</table>", cells(head, "th"));
        // The last, so that nothing in the other texts is taken for a place of it.
        Ok(PAGE
            .replace("{{LEAD}}", &lead)
            .replace("{{HISTOGRAM}}", &self.histogram())
            .replace("{{PLACES}}", &places)
            .replace("{{TABLE}}", &table)
            .replace("{{TITLE}}", &escaped(self.title)))
    }

    /// Writes the page.
    ///
    /// # Errors
    /// If an image cannot be encoded, or the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        AtomicFile::write(path, self.text()?.as_bytes())
    }

    fn histogram(&self) -> String {
        const SIZE: [f64; 2] = [640.0, 170.0];
        let most = self.histogram.iter().map(|(_, count)| *count).max().unwrap_or(0);
        if most == 0 {
            return "<p>No depth can be trusted.</p>".into();
        }
        let width = SIZE[0] / self.histogram.len() as f64;
        let mut svg = format!("<svg viewBox=\"0 0 {} {}\" role=\"img\">\n", SIZE[0], SIZE[1] + 40.0);
        for (k, (low, count)) in self.histogram.iter().enumerate() {
            let (x, height) = (k as f64 * width, SIZE[1] * *count as f64 / most as f64);
            let _ = writeln!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\" fill=\"#3b6ea5\"/>",
                SIZE[1] - height,
                width - 1.0
            );
            if k % 4 == 0 {
                let digits = (1.0 - low.log10().floor()).clamp(0.0, 9.0) as usize;
                let _ = writeln!(svg, "<text x=\"{x:.1}\" y=\"{:.1}\">{low:.digits$}</text>", SIZE[1] + 16.0);
            }
        }
        let text = format!("deviation of trusted depths ({})", escaped(self.unit));
        let _ = write!(svg, "<text x=\"0\" y=\"{:.1}\">{text}</text>\n</svg>", SIZE[1] + 34.0);
        svg
    }
}

pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;").replace('{', "&#123;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_its_parts_and_nothing_from_elsewhere() {
        let page = DepthPage {
            title: "a <b> {{TABLE}}",
            lead: vec!["<script>x</script>".into()],
            shares: vec![("trusted".into(), 0.75, "#fff"), ("in front".into(), 0.25, "#000")],
            unit: "m",
            histogram: (0..8).map(|k| (0.001 * 2_f64.powi(k), k as u64)).collect(),
            places: vec![Place { text: "here & there".into(), images: vec![RgbImage::new(3, 2); 2] }],
            table: (vec!["name".into()], vec![vec!["{{LEAD}}".into()]]),
        };
        let text = page.text().unwrap();
        assert!(!text.contains("<script") && !text.contains("{{") && !text.contains("http"), "{text}");
        assert!(text.contains("<title>a &lt;b> &#123;&#123;TABLE}}: depth") && text.contains("here &amp; there"));
        assert_eq!((text.matches("<img src=\"data:image/jpeg").count(), text.matches("<rect").count()), (2, 8));
        assert!(text.contains("width:75.00%") && text.contains(">0.0010<"), "{text}");
        let empty = DepthPage { histogram: vec![(1.0, 0)], shares: vec![], places: vec![], ..page };
        assert!(empty.text().unwrap().contains("No depth can be trusted."));
    }
}
