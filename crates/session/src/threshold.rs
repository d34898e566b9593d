//! A threshold of log10 U, as a number or by its share of visible surfaces.

use octobayes::monitor::Message;
use octobayes::render::RenderedView;
use octobayes::uncertainty::{BakedField, NEARLY_ALL, threshold_warning};
use octobayes::{Error, Result};

/// Share of the pixels that a share of visible surfaces may take without a word.
const MAX_QUIET_PIXEL_SHARE: f64 = 0.05;
/// The same, in shares of the surfaces that go.
const MAX_QUIET_RATIO: f64 = 3.0;

/// Where the clean-up cuts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Threshold {
    /// log10 U.
    Log10(f64),
    /// Share of the visible surfaces that stays, the most certain first.
    Share(f64),
}

impl Threshold {
    /// `4.2`, or `99%`.
    ///
    /// # Errors
    /// If the text is neither; with what was expected.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        let expected = "expected log10 U as a number, or a share of visible surfaces as 99%";
        match text.strip_suffix('%').map(|share| share.trim().parse::<f64>()) {
            Some(Ok(percent)) if (0.0..=100.0).contains(&percent) => Ok(Self::Share(0.01 * percent)),
            Some(_) => Err(format!("{expected}, from 0% to 100%")),
            None => text.parse().ok().filter(|v: &f64| v.is_finite()).map(Self::Log10).ok_or_else(|| expected.into()),
        }
    }

    /// log10 U of the threshold in a field. Notes it if it had to be found, and warns if it leaves hardly any visible
    /// surface.
    ///
    /// # Errors
    /// If a share is requested of a field without points on visible surfaces.
    pub fn log10(self, field: &BakedField, tell: &mut dyn FnMut(Message)) -> Result<f64> {
        let prior = field.field().prior().log10();
        match self {
            Self::Log10(log10) => {
                if log10 >= prior {
                    let share = (0.0..=100.0).contains(&log10).then(|| field.surface_quantiles([0.01 * log10]));
                    let hint = share.flatten().map_or(String::new(), |[usual]| {
                        format!("; as a share of visible surfaces, {log10}%, the threshold is log10 U = {usual:.3}")
                    });
                    tell(Message::Warning(format!(
                        "--threshold: no density lies above {log10}: the field's largest log10 U, its prior, is \
                         {prior:.3}{hint}"
                    )));
                }
                let warning = threshold_warning(field, log10);
                warning.iter().for_each(|text| tell(Message::Warning(format!("--threshold: {text}"))));
                Ok(log10)
            }
            Self::Share(share) => {
                let Some([log10]) = field.surface_quantiles([share]) else {
                    let expected = "a field with points on visible surfaces, for a share";
                    return Err(Error::setting("--threshold", expected, "one without"));
                };
                let percent = 100.0 * share;
                tell(Message::Note(format!("log10 U is at most {log10:.3} on {percent}% of the visible surfaces")));
                Ok(log10)
            }
        }
    }

    /// Notes if the threshold removes many more of a view's pixels than its value suggests: a share removes
    /// several times itself, or a number removes nearly all, and `field` gave no warning.
    pub fn note_pixels(
        self,
        view: &RenderedView,
        cleaned: &RenderedView,
        field: &BakedField,
        tell: &mut dyn FnMut(Message),
    ) {
        let Some(removed) = removed_share(view, cleaned) else { return };
        let percent = 100.0 * removed;
        match self {
            Self::Share(kept) if removed > MAX_QUIET_PIXEL_SHARE.max(MAX_QUIET_RATIO * (1.0 - kept)) => {
                tell(Message::Note(format!(
                    "the clean-up removes {percent:.1} % of the pixels that show matter in this view, although {}% \
                     of the visible surfaces stay: these pixels show fog, a side that no training ray saw, or what \
                     lies outside the field's box",
                    100.0 * kept
                )));
            }
            Self::Log10(log10) if removed >= NEARLY_ALL && threshold_warning(field, log10).is_none() => {
                tell(Message::Warning(format!(
                    "the clean-up removes {percent:.1} % of the pixels that show matter in this view: log10 U is above \
                     {log10} there (a share of visible surfaces has a percent sign: --threshold 99%)"
                )));
            }
            _ => {}
        }
    }
}

/// Share of the pixels that show matter (opacity above ½) and do so no longer; `None` if there are none.
fn removed_share(view: &RenderedView, cleaned: &RenderedView) -> Option<f64> {
    let shown = |view: &RenderedView, i: usize| view.pixels[i].opacity > 0.5;
    let before: Vec<usize> = (0..view.pixels.len()).filter(|&i| shown(view, i)).collect();
    let removed = before.iter().filter(|&&i| !shown(cleaned, i)).count();
    (!before.is_empty()).then(|| removed as f64 / before.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_numbers_or_shares() {
        let parse = |text| Threshold::parse(text).ok();
        assert_eq!(parse("-1.5"), Some(Threshold::Log10(-1.5)));
        assert_eq!(parse("99 %"), Some(Threshold::Share(0.99)));
        assert_eq!([parse("101%"), parse("x%"), parse("inf"), parse("nan"), parse("")], [None; 5]);
    }
}
