//! Parsers of option values.

use clap::builder::{OsStringValueParser, TypedValueParser};
use glam::{DVec3, Vec3};

use crate::dataset::Selection;
use crate::geometry::{Aabb, Camera, MAX_PIXELS};
use crate::octree::Tile;
use crate::posterior::DataScale;

/// Largest coordinate, and other number of a list, that a command line may have: f32 positions are 64 apart there.
const FARTHEST: f64 = 1e9;
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
    if parts.iter().any(|v| v.is_nan() || v.abs() > FARTHEST) {
        return Err(format!("numbers must be finite, from -{FARTHEST:e} to {FARTHEST:e}"));
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

/// A requested image size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resolution {
    /// This width; the height follows from the camera's own aspect ratio.
    Width(u32),
    /// Width and height.
    Size([u32; 2]),
}

impl Resolution {
    /// The size to ask for before any camera is known, if it is known.
    pub fn size(self) -> Option<[u32; 2]> {
        match self {
            Self::Width(_) => None,
            Self::Size(size) => Some(size),
        }
    }

    /// The camera at this size.
    pub fn apply(self, camera: &Camera) -> Camera {
        match self {
            Self::Width(width) => scaled(camera, f64::from(width) / f64::from(camera.resolution[0])),
            Self::Size(size) => camera.resized(size),
        }
    }
}

/// The camera with sides times `scale`, at least a pixel and at most what an image may have.
pub fn scaled(camera: &Camera, scale: f64) -> Camera {
    let side = |side: u32| (f64::from(side) * scale).round().clamp(1.0, 65_536.0) as u32;
    camera.resized(camera.resolution.map(side))
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

/// `I/N` with I < N, N a power of two.
pub fn parse_tile(text: &str) -> Result<Tile, String> {
    let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    let tile = numbers.and_then(|(index, of)| Tile::new(index, of));
    tile.ok_or_else(|| format!("expected I/N with 0 <= I < N, N = 2, 4, 8, ... {}", Tile::MOST))
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

/// The same as PSNR in dB.
pub fn parse_psnr(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(psnr) if DataScale::NOISE.contains(&DataScale::noise_of(psnr)) => Ok(psnr),
        _ => Err(format!(
            "expected a PSNR in dB, from {:.2}, which a plain grey picture reaches, to {:.0}, far beyond 8 bits",
            DataScale::psnr_of(*DataScale::NOISE.end()),
            DataScale::psnr_of(*DataScale::NOISE.start())
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

/// Frames from a first to before a last: `0..8`.
pub fn parse_frames(text: &str) -> Result<std::ops::Range<usize>, String> {
    let ends = text.split_once("..").map(|(a, b)| (a.parse::<usize>(), b.parse::<usize>()));
    match ends {
        Some((Ok(a), Ok(b))) if a < b && b - a <= 10_000 => Ok(a..b),
        _ => Err("expected A..B with A < B, at most 10000 frames, as 0..8".into()),
    }
}

/// A number of bytes: `2GiB`, `500MB`, `1000000`.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let split = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let factor = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
        _ => return Err(format!("`{unit}` is not a unit of memory such as MB, GB, MiB or GiB")),
    };
    let bytes = parse_positive(number.trim())? * factor;
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err("expected from 1 byte to 10^18".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_width_alone_keeps_the_aspect_ratio() {
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.7, [1080, 1920]);
        let small = Resolution::Width(200).apply(&camera);
        assert_eq!(small.resolution, [200, 356]);
        // 355.6 is rounded, and the pixels with it: they stay square to within that.
        assert!((small.focal[0] / small.focal[1] - 1.0).abs() < 0.5 / 356.0);
        assert_eq!(Resolution::Size([30, 20]).apply(&camera).resolution, [30, 20]);
        assert_eq!(scaled(&camera, 1e-9).resolution, [1, 1]);
    }

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
