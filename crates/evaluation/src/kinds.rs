//! Kinds of pixels. Errors of depth mean different things at a silhouette and on a wall, and where most pixels are of
//! one kind, figures over all of them say little of the others.

use octobayes_data::{DepthMap, Unmeasured};
use serde::Serialize;

use super::{ByError, DepthError, EvaluatedView, Evaluator};
use crate::metrics::{Calibration, ErrorKind, Sparsification, sparsification};

/// A depth jumps between pixels if it changes by more than this, in longest edges of the model's box, or of that of the
/// ball, if space is contracted.
pub const JUMP: f64 = 0.04;
/// What is thin is at most so many pixels wide, along x or y.
pub const THIN: usize = 5;

octobayes::choices! {
    /// What a pixel of a held-out view shows. A pixel may be of several kinds.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, serde::Deserialize)]
    pub enum PixelKind {
        Object = "object", "the object, by masks of it";
        Around = "around", "what is around the object, by the same masks";
        Silhouette = "silhouette", "a pixel beside a jump of the true depth";
        Thin = "thin", "what is at most five pixels wide, before something farther or nothing";
        NeverSeen = "never seen", "what no training camera saw";
        InFront = "in front", "a median depth in front of the true surface by more than a jump";
        Other = "other", "neither a silhouette nor thin, seen if that is known, and not in front";
    }
}

/// What is known of the pixels of a true view, beside their depth.
#[derive(Debug, Clone, Default)]
pub struct TrueParts {
    /// `[height · width]`, or empty if no depth is known.
    pub outlines: Vec<Outline>,
    /// `[height · width]`: whether it shows the object; empty if that is not known.
    pub object: Vec<bool>,
    /// What a depth changes by where it jumps, scene units.
    pub jump: f64,
    /// Standard deviation of true depths that are known in steps, scene units: a step / √12.
    pub rounding: f64,
}

/// Where a pixel lies in the true depth map of its view.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outline {
    /// Beside a jump.
    pub is_silhouette: bool,
    /// Part of something narrow.
    pub is_thin: bool,
}

/// The outline of every pixel `[height · width]` of a depth map. `is_empty` are pixels that show nothing; what has no
/// known depth is no jump. `jump` is in scene units.
pub(crate) fn outlines(
    map: &DepthMap,
    [width, height]: [usize; 2],
    is_empty: impl Fn(usize) -> bool,
    jump: f64,
) -> Vec<Outline> {
    let distances: Vec<Option<f64>> = (0..width * height)
        .map(|i| match map.distance[i] {
            _ if is_empty(i) => Some(f64::INFINITY),
            Ok(distance) => Some(distance),
            Err(Unmeasured::Beyond) => Some(f64::INFINITY),
            Err(_) => None,
        })
        .collect();
    let at = |x: isize, y: isize| -> Option<f64> {
        let is_inside = (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
        is_inside.then(|| distances[y as usize * width + x as usize]).flatten()
    };
    let outline = |i: usize| {
        let Some(own) = distances[i].filter(|own| own.is_finite()) else { return Outline::default() };
        let (x, y) = ((i % width) as isize, (i / width) as isize);
        let beside = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        let jumps = |d: f64| (d - own).abs() > jump;
        // How many pixels away it is farther by a jump.
        let edge = |dx: isize, dy: isize| {
            (1..=THIN).find(|&k| at(x + k as isize * dx, y + k as isize * dy).is_some_and(|d| d > own + jump))
        };
        let is_narrow = |dx: isize, dy: isize| edge(-dx, -dy).zip(edge(dx, dy)).is_some_and(|(a, b)| a + b - 1 <= THIN);
        Outline {
            is_silhouette: beside.into_iter().any(|(dx, dy)| at(x + dx, y + dy).is_some_and(jumps)),
            is_thin: is_narrow(1, 0) || is_narrow(0, 1),
        }
    };
    (0..distances.len()).map(outline).collect()
}

/// The pixels of one kind, and how depth and measures do on them.
#[derive(Debug, Clone, Serialize)]
pub struct OfKind {
    /// Which they are.
    pub kind: PixelKind,
    /// Their share of all pixels whose depth is compared.
    pub share: f64,
    /// Error of depth.
    pub depth_error: DepthError,
    /// All measures, in the order of [`Evaluator::measures`].
    pub measures: Vec<MeasureOfKind>,
}

/// A measure over the pixels of a kind.
#[derive(Debug, Clone, Serialize)]
pub struct MeasureOfKind {
    /// Its name.
    pub name: String,
    /// Area under the sparsification error; `None` if there are too few pixels.
    pub ause: Option<ByError>,
    /// The same, where both curves are divided by their start.
    pub ause_from_start: Option<ByError>,
    /// Calibration, if the measure is a deviation of depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
}

impl OfKind {
    /// All kinds that are known and have pixels.
    pub(crate) fn all(evaluator: &Evaluator, views: &[EvaluatedView]) -> Vec<Self> {
        PixelKind::ALL.into_iter().filter_map(|kind| Self::new(evaluator, views, kind)).collect()
    }

    fn new(evaluator: &Evaluator, views: &[EvaluatedView], kind: PixelKind) -> Option<Self> {
        let is: Vec<&[bool]> = views.iter().map(|view| view.of_kind(kind)).collect::<Option<_>>()?;
        let chosen = |values: &dyn Fn(&EvaluatedView) -> &Vec<f64>| -> Vec<f64> {
            let of_view = |(view, is): (&EvaluatedView, &&[bool])| -> Vec<f64> {
                values(view).iter().zip(*is).filter(|(_, is)| **is).map(|(value, _)| *value).collect()
            };
            views.iter().zip(&is).flat_map(of_view).collect()
        };
        let errors = chosen(&|view| &view.absolute_error);
        let of_measure = |(m, measure)| {
            let values = chosen(&|view| &view.measures[m]);
            let curves = ErrorKind::ALL.map(|kind| sparsification(&values, &errors, kind));
            let area = |of: fn(&Sparsification) -> f64| -> Option<ByError> {
                let [mae, mse, rmse] = curves.each_ref().map(|curve| curve.as_ref().map(of));
                Some([mae?, mse?, rmse?].into())
            };
            let part = evaluator.calibration_of(views, m, |view| view.of_kind(kind).unwrap_or_default());
            MeasureOfKind {
                name: evaluator.name(measure),
                ause: area(|curve| curve.area),
                ause_from_start: area(Sparsification::area_from_start),
                calibration: part.and_then(|part| part.calibration),
            }
        };
        let all: usize = views.iter().map(|view| view.pixels.len()).sum();
        let share = errors.len() as f64 / all as f64;
        let measures = evaluator.measures().into_iter().enumerate().map(of_measure).collect();
        Some(Self { kind, share, measures, depth_error: DepthError::of(errors)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Distances of a map; `x` has no known depth, `.` shows nothing.
    fn outlines_of(rows: &[&str]) -> Vec<Outline> {
        let size = [rows[0].len(), rows.len()];
        let text: Vec<char> = rows.iter().flat_map(|row| row.chars()).collect();
        let distance = |c: &char| c.to_digit(10).map(f64::from).ok_or(Unmeasured::Zero);
        let resolution = size.map(|n| n as u32);
        let map = DepthMap { resolution, distance: text.iter().map(distance).collect(), step: 0.0 };
        outlines(&map, size, |i| text[i] == '.', 1.5)
    }

    #[test]
    fn silhouettes_are_on_both_sides_of_a_jump() {
        let found = outlines_of(&["1119999", "1119999", "1119999"]);
        let silhouette: Vec<bool> = found.iter().map(|outline| outline.is_silhouette).collect();
        assert_eq!(silhouette[..7], [false, false, true, true, false, false, false]);
        assert!(found.iter().all(|outline| !outline.is_thin));
        // Slopes, and what is not known, are no jumps; what is empty is one.
        let found = outlines_of(&["12345x9", "12345x9", "12345.9"]);
        let silhouette: Vec<bool> = found.iter().map(|outline| outline.is_silhouette).collect();
        assert_eq!(silhouette[..7], [false; 7]);
        assert_eq!(silhouette[14..], [false, false, false, false, true, false, true]);
    }

    #[test]
    fn a_rod_is_thin_and_the_wall_behind_it_is_not() {
        let found = outlines_of(&["9999211129999", "9999211129999"]);
        let thin: Vec<usize> = (0..13).filter(|&i| found[i].is_thin).collect();
        assert_eq!(thin, [4, 5, 6, 7, 8]);
        let found = outlines_of(&["9992111129999"]);
        assert!(found.iter().all(|outline| !outline.is_thin), "six pixels wide");
    }
}
