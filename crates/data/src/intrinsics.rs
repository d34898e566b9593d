//! Focal length, principal point and lens of one camera, as camera files state them.
//!
//! A statement of a frame takes precedence over the file's statement of the same quantity, whatever key either uses:
//! a frame's `camera_angle_x` replaces the file's `fl_x`. Two statements side by side must agree.

use serde::Deserialize;

use octobayes::geometry::{Distortion, MAX_REACH};

/// Two statements of one focal length may differ by this share, for files round their angles.
const AGREE: f64 = 0.01;

/// What is wrong with intrinsics: keys, what they should be, and what they are.
#[derive(Debug, PartialEq)]
pub(super) struct Fault {
    pub place: &'static str,
    pub expected: String,
    pub found: String,
}

impl Fault {
    fn new(place: &'static str, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { place, expected: expected.into(), found: found.into() }
    }
}

type Checked<T> = Result<T, Fault>;

/// The statements of a frame, or of a file for all frames.
#[derive(Debug, Clone, Default, Deserialize)]
pub(super) struct Intrinsics {
    /// Angles of view, radians.
    pub camera_angle_x: Option<f64>,
    pub camera_angle_y: Option<f64>,
    /// Angles of view, degrees (instant-ngp).
    pub x_fov: Option<f64>,
    pub y_fov: Option<f64>,
    /// Pixels, of an image of w × h.
    pub fl_x: Option<f64>,
    pub fl_y: Option<f64>,
    pub cx: Option<f64>,
    pub cy: Option<f64>,
    pub w: Option<f64>,
    pub h: Option<f64>,
    /// OpenCV's coefficients.
    pub k1: Option<f64>,
    pub k2: Option<f64>,
    pub k3: Option<f64>,
    pub k4: Option<f64>,
    pub k5: Option<f64>,
    pub k6: Option<f64>,
    pub p1: Option<f64>,
    pub p2: Option<f64>,
    /// nerfstudio's list: k1, k2, k3, k4, p1, p2.
    pub distortion_params: Option<Vec<f64>>,
}

/// The statements of a focal length along one axis: key, value, and whether it is in pixels.
type Focal = [(&'static str, Option<f64>); 3];

impl Intrinsics {
    fn focal_x(&self) -> Focal {
        [("fl_x", self.fl_x), ("camera_angle_x", self.camera_angle_x), ("x_fov", self.x_fov)]
    }

    fn focal_y(&self) -> Focal {
        [("fl_y", self.fl_y), ("camera_angle_y", self.camera_angle_y), ("y_fov", self.y_fov)]
    }

    /// Turns a list of coefficients into single ones, which it may repeat but not contradict.
    fn with_single_coefficients(self) -> Checked<Self> {
        let Some(list) = &self.distortion_params else { return Ok(self) };
        let place = "`distortion_params`";
        let &[k1, k2, k3, k4, p1, p2] = list.as_slice() else {
            return Err(Fault::new(place, "six numbers: k1, k2, k3, k4, p1, p2", format!("{list:?}")));
        };
        let listed = [k1, k2, k3, k4, p1, p2];
        let single = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
        if single.iter().zip(listed).any(|(single, listed)| single.is_some_and(|single| single != listed)) {
            let names = ["k1", "k2", "k3", "k4", "p1", "p2"].into_iter().zip(single);
            let stated: Vec<String> = names.filter_map(|(name, v)| Some(format!("{name} {}", v?))).collect();
            return Err(Fault::new(place, format!("the same as {}", stated.join(", ")), format!("{list:?}")));
        }
        let [k1, k2, k3, k4, p1, p2] = listed.map(Some);
        Ok(Self { k1, k2, k3, k4, p1, p2, distortion_params: None, ..self })
    }

    /// The frame's statements where it has them, else those of the file.
    pub fn over(self, file: &Self) -> Checked<Self> {
        let (own, file) = (self.with_single_coefficients()?, file.clone().with_single_coefficients()?);
        let states = |focal: Focal| focal.iter().any(|(_, value)| value.is_some());
        // A frame that states one axis alone has square pixels, whatever the file has for the other axis.
        let focal = if states(own.focal_x()) || states(own.focal_y()) { &own } else { &file };
        Ok(Self {
            camera_angle_x: focal.camera_angle_x,
            camera_angle_y: focal.camera_angle_y,
            x_fov: focal.x_fov,
            y_fov: focal.y_fov,
            fl_x: focal.fl_x,
            fl_y: focal.fl_y,
            cx: own.cx.or(file.cx),
            cy: own.cy.or(file.cy),
            w: own.w.or(file.w),
            h: own.h.or(file.h),
            k1: own.k1.or(file.k1),
            k2: own.k2.or(file.k2),
            k3: own.k3.or(file.k3),
            k4: own.k4.or(file.k4),
            k5: own.k5.or(file.k5),
            k6: own.k6.or(file.k6),
            p1: own.p1.or(file.p1),
            p2: own.p2.or(file.p2),
            distortion_params: None,
        })
    }

    /// The first key whose value is in pixels, so that the size of the image must be known.
    pub fn in_pixels(&self) -> Option<&'static str> {
        let keys = [("fl_x", self.fl_x), ("fl_y", self.fl_y), ("cx", self.cx), ("cy", self.cy)];
        keys.into_iter().find_map(|(key, value)| value.map(|_| key))
    }

    /// The lens distortion. If the file names no camera model, k3 and k4 must be 0: nerfstudio applies them,
    /// instant-ngp does not.
    pub fn distortion(&self, names_model: bool) -> Checked<Distortion> {
        let value = |v: Option<f64>| v.unwrap_or(0.0);
        let k = [self.k1, self.k2, self.k3, self.k4].map(value);
        let distortion = Distortion { k, p: [self.p1, self.p2].map(value) };
        let higher = [("k3", self.k3), ("k4", self.k4), ("k5", self.k5), ("k6", self.k6)];
        let unread = if names_model { &higher[2..] } else { &higher[..] };
        let unread: Vec<String> =
            unread.iter().filter(|(_, v)| value(*v) != 0.0).map(|(name, v)| format!("{name} {}", value(*v))).collect();
        let finite = distortion.k.iter().chain(&distortion.p).all(|c| c.is_finite());
        if unread.is_empty() && finite {
            return Ok(distortion);
        }
        let found = if unread.is_empty() { distortion.to_string() } else { unread.join(", ") };
        let expected = match names_model {
            true => "a perspective lens with OpenCV's k1, k2, k3, p1, p2 and nerfstudio's k4",
            false => {
                "a perspective lens with OpenCV's k1, k2, p1, p2; k3 and k4 count beside a `camera_model`, such as \
                 OPENCV, as in nerfstudio: instant-ngp passes them over"
            }
        };
        Err(Fault::new("lens", expected, found))
    }

    /// Focal lengths and principal point in pixels of an image of `size`, to which the pixels of all keys refer.
    pub fn project(&self, size: [u32; 2]) -> Checked<([f64; 2], [f64; 2])> {
        let [w, h] = size.map(f64::from);
        let fx = focal_length(self.focal_x(), w)?;
        let fy = focal_length(self.focal_y(), h)?;
        let expected = "positive `fl_x` (pixels), `camera_angle_x` (radians, below pi) or `x_fov` (degrees, below 180)";
        let focal = match (fx, fy) {
            (Some(fx), Some(fy)) => [fx, fy],
            // Square pixels.
            (Some(f), None) | (None, Some(f)) => [f; 2],
            (None, None) => return Err(Fault::new("intrinsics", expected, "none of them")),
        };
        let center = [self.cx.unwrap_or(0.5 * w), self.cy.unwrap_or(0.5 * h)];
        // Corners of the image on the plane at depth 1.
        let reach = [0, 1].map(|k| center[k].abs().max(([w, h][k] - center[k]).abs()) / focal[k]);
        if focal.iter().all(|f| *f > 0.0 && f.is_finite()) && reach.iter().all(|r| *r < MAX_REACH) {
            Ok((focal, center))
        } else {
            let [fx, fy] = focal;
            Err(Fault::new("intrinsics", expected, format!("focal lengths {fx}, {fy}, principal point {center:?}")))
        }
    }
}

/// The focal length in pixels along an axis of `side` pixels; `None` if nothing states it.
fn focal_length(stated: Focal, side: f64) -> Checked<Option<f64>> {
    let [(pixels, f), (radians, angle), (degrees, fov)] = stated;
    let of = |key: &str, angle: f64, half_turn: f64, unit: &str| {
        // An angle in degrees, such as 40, would also give a positive tangent.
        if angle > 0.0 && angle < half_turn {
            return Ok(0.5 * side / (0.5 * angle * std::f64::consts::PI / half_turn).tan());
        }
        let expected = format!("an angle in {unit} between 0 and {half_turn:.4}");
        Err(Fault::new("intrinsics", expected, format!("`{key}` {angle}")))
    };
    let values = [
        (pixels, f, f),
        (radians, angle, angle.map(|a| of(radians, a, std::f64::consts::PI, "radians")).transpose()?),
        (degrees, fov, fov.map(|a| of(degrees, a, 180.0, "degrees")).transpose()?),
    ];
    let mut values = values.into_iter().filter_map(|(key, value, f)| Some((key, value?, f?)));
    let Some((first, value, f)) = values.next() else { return Ok(None) };
    match values.find(|(_, _, other)| (other - f).abs() > AGREE * f.abs() || !(other - f).is_finite()) {
        None => Ok(Some(f)),
        Some((key, other, g)) => Err(Fault::new(
            "intrinsics",
            format!(
                "statements that agree for an image of {side} pixels: `{first}` {value} is a focal length of {f:.2}"
            ),
            format!("`{key}` {other}, a focal length of {g:.2}"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stated(json: &str) -> Intrinsics {
        serde_json::from_str(json).unwrap()
    }

    /// Focal lengths and principal point of a frame in a file, for an image of 100 × 80.
    fn projected(file: &str, frame: &str) -> Checked<([f64; 2], [f64; 2])> {
        stated(frame).over(&stated(file))?.project([100, 80])
    }

    #[test]
    fn the_nearer_statement_of_a_focal_length_counts() {
        let half = |f: f64| 2.0 * (50.0 / f).atan();
        let focal = |file: &str, frame: &str| projected(file, frame).map(|(focal, _)| focal);
        // A frame's angle replaces the file's pixels, and the other way round.
        let angle = format!(r#"{{"camera_angle_x": {}}}"#, half(200.0));
        let [fx, fy] = focal(r#"{"fl_x": 138, "fl_y": 138}"#, &angle).unwrap();
        assert!((fx - 200.0).abs() < 1e-9 && (fy - 200.0).abs() < 1e-9, "{fx}, {fy}");
        assert_eq!(focal(&angle, r#"{"fl_x": 138}"#).unwrap(), [138.0; 2]);
        let degrees = format!(r#"{{"x_fov": {}}}"#, half(200.0).to_degrees());
        let [fx, _] = focal(r#"{"camera_angle_x": 0.7}"#, &degrees).unwrap();
        assert!((fx - 200.0).abs() < 1e-9, "{fx}");
        // Without a statement of its own, a frame has all of the file's.
        assert_eq!(focal(r#"{"fl_x": 138, "fl_y": 140}"#, r#"{"cx": 3}"#).unwrap(), [138.0, 140.0]);
        // The other axis by its angle.
        let [fx, fy] = focal(&format!(r#"{{"fl_x": 138, "camera_angle_y": {}}}"#, half(125.0)), "{}").unwrap();
        assert!(fx == 138.0 && (fy - 100.0).abs() < 1e-9, "{fx}, {fy}");
    }

    #[test]
    fn statements_that_contradict_each_other_are_refused_with_both_values() {
        let rounded = 2.0 * (50.0_f64 / 139.0).atan();
        let near = projected(&format!(r#"{{"fl_x": 138, "camera_angle_x": {rounded}}}"#), "{}");
        assert_eq!(near.unwrap().0, [138.0; 2]);
        let fault = projected(r#"{"fl_x": 138, "camera_angle_x": 0.9}"#, "{}").unwrap_err();
        assert!(fault.expected.contains("`fl_x` 138") && fault.found.contains("`camera_angle_x` 0.9"), "{fault:?}");
        let fault = projected("{}", r#"{"fl_x": 90, "fl_y": 90, "y_fov": 100}"#).unwrap_err();
        assert!(fault.expected.contains("`fl_y` 90") && fault.found.contains("`y_fov` 100"), "{fault:?}");
        let list = r#"{"fl_x": 9, "distortion_params": [0.1, 0, 0, 0, 0, 0], "k1": 0.2}"#;
        let fault = projected(list, "{}").unwrap_err();
        assert!(fault.expected.contains("k1 0.2") && fault.found.contains("[0.1,"), "{fault:?}");
    }

    #[test]
    fn a_list_of_coefficients_is_what_single_ones_are() {
        let list = stated(r#"{"distortion_params": [0.1, -0.02, 0, 0, 0.003, -0.004], "p1": 0.003}"#);
        let lens = Intrinsics::default().over(&list).unwrap().distortion(false).unwrap();
        assert_eq!(lens, Distortion { k: [0.1, -0.02, 0.0, 0.0], p: [0.003, -0.004] });
        // A frame's own coefficient replaces that of the file's list.
        let lens = stated(r#"{"k1": 0.3}"#).over(&list).unwrap().distortion(false).unwrap();
        assert_eq!(lens.k, [0.3, -0.02, 0.0, 0.0]);
        for (json, found) in [
            (r#"{"distortion_params": [0.1, 0, 0.5, 0, 0, 0]}"#, "k3 0.5"),
            (r#"{"k3": 0.5, "k6": 1}"#, "k3 0.5, k6 1"),
            (r#"{"distortion_params": [0.1, 0, 0, 0]}"#, "[0.1, 0.0, 0.0, 0.0]"),
        ] {
            let fault = Intrinsics::default().over(&stated(json)).and_then(|i| i.distortion(false)).unwrap_err();
            assert_eq!(fault.found, found);
        }
    }

    #[test]
    fn k3_and_k4_count_where_a_camera_model_is_named() {
        let of = |json| Intrinsics::default().over(&stated(json)).unwrap().distortion(true);
        let expected = Distortion { k: [0.1, -0.02, 0.5, -0.25], p: [0.003, -0.004] };
        assert_eq!(of(r#"{"distortion_params": [0.1, -0.02, 0.5, -0.25, 0.003, -0.004]}"#).unwrap(), expected);
        let single = r#"{"k1": 0.1, "k2": -0.02, "k3": 0.5, "k4": -0.25, "p1": 0.003, "p2": -0.004, "k5": 0, "k6": 0}"#;
        assert_eq!(of(single).unwrap(), expected);
        assert_eq!(of(r#"{"k3": 0.5, "k5": 1, "k6": 2}"#).unwrap_err().found, "k5 1, k6 2");
        let endless = Intrinsics { k3: Some(f64::INFINITY), ..Intrinsics::default() };
        assert_eq!(endless.distortion(true).unwrap_err().found, "k1 0, k2 0, k3 inf, p1 0, p2 0");
    }

    #[test]
    fn impossible_angles_are_refused() {
        for (json, found) in
            [(r#"{"x_fov": 180}"#, "`x_fov` 180"), (r#"{"camera_angle_y": 40}"#, "`camera_angle_y` 40")]
        {
            assert_eq!(projected(json, "{}").unwrap_err().found, found);
        }
        assert_eq!(projected("{}", "{}").unwrap_err().found, "none of them");
    }
}
