//! Parsers of option values.

use clap::builder::{OsStringValueParser, PossibleValue, PossibleValuesParser, TypedValueParser};
use glam::{DVec3, Vec3};

use super::numbers::MAX_KEPT_COUNT;
use octobayes::choices::Choice;
use octobayes::geometry::{Aabb, MAX_PIXELS, Norm};
use octobayes::posterior::DataScale;
use octobayes_data::Selection;
use octobayes_session::Resolution;

/// Largest coordinate, and other number of a list, that a command line may have: f32 positions are 64 apart there.
const MAX_COORDINATE: f64 = 1e9;
/// Shortest edge of a box.
const SHORTEST: f64 = 1e-9;
/// Numbers that a command line may have apart from 0: their squares and inverses are numbers, too, and f32 holds them.
const RANGE: std::ops::RangeInclusive<f64> = 1e-30..=1e30;
/// Angles of view, degrees. Outside, rays are parallel or longer than any number.
const ANGLES: std::ops::RangeInclusive<f64> = 1e-3..=179.9;

/// What the name of a model is, which stands in messages and files.
pub const UTF_8: &str = "a path in UTF-8 (rename the file, or make a link to it)";

/// The name of a model.
pub fn model_name() -> impl TypedValueParser<Value = String> {
    OsStringValueParser::new().try_map(|name| name.into_string().map_err(|_| format!("expected {UTF_8}")))
}

/// Numbers separated by commas.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parts: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().map_err(|_| format!("`{part}` is not a number")))
        .collect::<Result<_, _>>()?;
    if parts.iter().any(|v| v.is_nan() || v.abs() > MAX_COORDINATE) {
        return Err(format!("numbers must be finite, from -{MAX_COORDINATE:e} to {MAX_COORDINATE:e}"));
    }
    <[f64; N]>::try_from(parts)
        .map_err(|parts| format!("expected {N} numbers separated by commas, found {}", parts.len()))
}

/// `x0,y0,z0,x1,y1,z1`.
pub fn parse_box(text: &str) -> Result<Aabb, String> {
    let [x0, y0, z0, x1, y1, z1] = numbers::<6>(text)?;
    let bounds = Aabb::new(DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)).map_err(|e| e.to_string())?;
    if bounds.size().min_element() < SHORTEST {
        return Err(format!("edges must be {SHORTEST:e} or longer"));
    }
    Ok(bounds)
}

/// `x,y,z`, a direction.
pub fn parse_direction(text: &str) -> Result<DVec3, String> {
    let direction = DVec3::from(numbers(text)?);
    direction.try_normalize().ok_or_else(|| "a direction must not be zero".into())
}

/// One of the values of an enum, by its name.
pub fn choice<T: Choice + Send + Sync>() -> impl TypedValueParser<Value = T> {
    let values = T::CHOICES.iter().map(|choice| PossibleValue::new(choice.name()).help(choice.help()));
    PossibleValuesParser::new(values).map(|name| T::named(&name).expect("the name of a choice"))
}

/// `l2` or `linf`.
pub fn parse_norm(text: &str) -> Result<Norm, String> {
    Norm::named(text).ok_or_else(|| "expected l2 or linf".into())
}

/// `l2:x,y,z,r`, or `linf:x,y,z,r`.
pub fn parse_contraction(text: &str) -> Result<(Norm, [f64; 4]), String> {
    let (name, ball) = text.split_once(':').ok_or("expected l2:x,y,z,r or linf:x,y,z,r")?;
    Ok((parse_norm(name)?, numbers(ball)?))
}

/// `offset,scale`.
pub fn parse_pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text)
}

/// `low,high`.
pub fn parse_range(text: &str) -> Result<[f64; 2], String> {
    let [low, high] = numbers(text)?;
    if low < high { Ok([low, high]) } else { Err("the first number must be below the second".into()) }
}

/// `white`, `black` or `r,g,b`.
pub fn parse_background(text: &str) -> Result<Vec3, String> {
    match text {
        "white" => Ok(Vec3::ONE),
        "black" => Ok(Vec3::ZERO),
        _ => {
            let color = DVec3::from(numbers::<3>(text)?).as_vec3();
            if color.min_element() >= 0.0 && color.max_element() <= 1.0 {
                Ok(color)
            } else {
                Err("red, green and blue must be from 0 to 1".into())
            }
        }
    }
}

/// A count, indices, or `all`.
pub fn parse_views(text: &str) -> Result<Selection, String> {
    let number = |part: &str| part.trim().parse::<usize>().map_err(|_| format!("`{part}` is not a whole number"));
    if text == "all" {
        return Ok(Selection::BothParts);
    }
    if !text.contains(',') {
        return match number(text)? {
            0 => Err("at least 1 image".into()),
            count => Ok(Selection::Count(count)),
        };
    }
    let mut indices = text.trim_end_matches(',').split(',').map(number).collect::<Result<Vec<_>, _>>()?;
    indices.sort_unstable();
    indices.dedup();
    Ok(Selection::Indices(indices))
}

/// `W` or `WxH`.
pub fn parse_resolution(text: &str) -> Result<Resolution, String> {
    let side = |text: &str| match text.parse::<u32>() {
        Ok(side) if (1..=65_536).contains(&side) => Ok(side),
        _ => Err(format!("`{text}` is not a whole number of pixels from 1 to 65536")),
    };
    match text.split_once('x') {
        Some((w, h)) => {
            let size = [side(w)?, side(h)?];
            let pixels = f64::from(size[0]) * f64::from(size[1]);
            if pixels <= MAX_PIXELS {
                Ok(Resolution::Size(size))
            } else {
                Err(format!("at most {MAX_PIXELS:e} pixels"))
            }
        }
        None => Ok(Resolution::Width(side(text)?)),
    }
}

/// A finite number above 0.
pub fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if RANGE.contains(&v) => Ok(v),
        _ => Err(format!("expected a finite number above 0, from {:e} to {:e}", RANGE.start(), RANGE.end())),
    }
}

/// A share, such as a weight: 0 to 1.
pub fn parse_share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=1.0).contains(&v) => Ok(v),
        _ => Err("expected a number from 0 to 1".into()),
    }
}

/// A probability that is neither impossible nor certain.
pub fn parse_probability(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(p) if p > 0.0 && p < 1.0 => Ok(p),
        _ => Err("expected a probability between 0 and 1, both excluded, such as 0.9".into()),
    }
}

/// A root mean square error of colours that training may leave.
pub fn parse_noise(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(noise) if DataScale::NOISE.contains(&noise) => Ok(noise),
        _ => Err(format!(
            "expected an error of colours in 0..1, from {:e}, far below a step of 8 bits, to {}, which a plain grey \
             picture keeps",
            DataScale::NOISE.start(),
            DataScale::NOISE.end()
        )),
    }
}

/// A finite number, 0 or more.
pub fn parse_non_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if v == 0.0 || RANGE.contains(&v) => Ok(v),
        _ => Err(format!("expected a finite number, 0 or more: 0, or from {:e} to {:e}", RANGE.start(), RANGE.end())),
    }
}

/// An angle of view in degrees.
pub fn parse_fov(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if ANGLES.contains(&v) => Ok(v),
        _ => Err(format!("expected an angle from {} to {} degrees", ANGLES.start(), ANGLES.end())),
    }
}

/// Frames by their numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Frames {
    One(usize),
    /// From a first to before a last.
    Many(std::ops::Range<usize>),
}

impl Frames {
    /// Their numbers.
    pub fn numbers(&self) -> std::ops::Range<usize> {
        match self {
            Self::One(k) => *k..k + 1,
            Self::Many(range) => range.clone(),
        }
    }

    /// Whether a range was given, even if it has one frame only.
    pub fn are_many(&self) -> bool {
        matches!(self, Self::Many(_))
    }
}

/// `3`, or frames from a first to before a last: `0..8`.
pub fn parse_frames(text: &str) -> Result<Frames, String> {
    let number = |text: &str| text.parse::<usize>().ok().filter(|k| *k as u64 <= MAX_KEPT_COUNT);
    let frames = match text.split_once("..") {
        None => number(text).map(Frames::One),
        Some((a, b)) => {
            number(a).zip(number(b)).filter(|(a, b)| a < b && b - a <= 10_000).map(|(a, b)| Frames::Many(a..b))
        }
    };
    frames.ok_or_else(|| {
        format!("expected a frame from 0 to {MAX_KEPT_COUNT}, or A..B with A < B, at most 10000, as 0..8")
    })
}

/// A number of bytes: `2GiB`, `500MB`, `1000000`.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    // Of a name such as MiB, the power is that of its first letter.
    let name = unit.to_ascii_lowercase().replace("ib", "b");
    let base = if name.len() < unit.len() { 1024_f64 } else { 1000.0 };
    let power = if unit.is_empty() { Some(0) } else { ["b", "kb", "mb", "gb", "tb"].iter().position(|u| *u == name) };
    let power = power.ok_or_else(|| format!("`{unit}` is not a unit of memory such as MB, GB, MiB or GiB"))?;
    let bytes = parse_positive(number.trim())? * base.powi(power as i32);
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err("expected from 1 byte to 10^18".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_become_settings_or_reasons() {
        assert!(parse_box("-1,-1,-1,1,1,1").is_ok());
        assert!(parse_box("1,1,1,-1,-1,-1").unwrap_err().contains("min < max"));
        assert!(parse_box("1,2,3").unwrap_err().contains("6 numbers"));
        assert!(parse_box("-1e9,-1,-1,1e9,1,1").is_ok() && parse_box("-1,-1,-1,1.1e9,1,1").is_err());
        assert!(parse_box("0,0,0,1e-9,1,1").is_ok() && parse_box("0,0,0,9e-10,1,1").is_err());
        assert_eq!(parse_background("0,0.5,1"), Ok(Vec3::new(0.0, 0.5, 1.0)));
        assert!(parse_background("0,0.5,2").is_err() && parse_background("red").is_err());
        assert_eq!(parse_resolution("80x60"), Ok(Resolution::Size([80, 60])));
        assert_eq!(parse_resolution("80"), Ok(Resolution::Width(80)));
        assert!(parse_resolution("0").is_err() && parse_resolution("8x").is_err());
        assert!(parse_resolution("10000x10000").is_ok() && parse_resolution("10000x10001").is_err());
        assert_eq!(parse_views("10"), Ok(Selection::Count(10)));
        assert_eq!(parse_views("7,0,31,7"), Ok(Selection::Indices(vec![0, 7, 31])));
        assert_eq!(parse_views("7,"), Ok(Selection::Indices(vec![7])));
        assert_eq!(parse_views("all"), Ok(Selection::BothParts));
        assert!(["0", "", "-1", "1,x", ","].iter().all(|text| parse_views(text).is_err()));
        assert_eq!(parse_contraction("linf:0,0,0,1.5"), Ok((Norm::Linf, [0.0, 0.0, 0.0, 1.5])));
        assert!(["l2", "l2:1", "l3:0,0,0,1", ""].iter().all(|text| parse_contraction(text).is_err()));
        assert_eq!((parse_frames("3"), parse_frames("0..8")), (Ok(Frames::One(3)), Ok(Frames::Many(0..8))));
        assert!(["", "-1", "8..8", "0..10001", "1e9", "0..", "x"].iter().all(|text| parse_frames(text).is_err()));
        assert!(parse_fov("60").is_ok() && ["179.91", "9e-4", "nan"].iter().all(|text| parse_fov(text).is_err()));
        assert_eq!((parse_bytes("2GiB"), parse_bytes("1.5 kB"), parse_bytes("7")), (Ok(2 << 30), Ok(1500), Ok(7)));
        assert!(parse_bytes("2 lines").is_err() && parse_bytes("0").is_err() && parse_bytes("1e30").is_err());
        assert!(parse_positive("-1").is_err() && parse_positive("nan").is_err() && parse_non_negative("0").is_ok());
        for parse in [parse_positive, parse_non_negative] {
            assert!(parse("1e30").is_ok() && parse("1e-30").is_ok());
            assert!(["1.1e30", "9e-31", "-1", "inf", "nan", ""].iter().all(|text| parse(text).is_err()));
        }
        assert!(["0", "1"].iter().all(|text| parse_share(text).is_ok()));
        assert!(["-1e-9", "1.1", "nan", ""].iter().all(|text| parse_share(text).is_err()));
    }
}
