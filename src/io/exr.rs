//! Multi-channel EXR images.

#[cfg(feature = "synth")]
mod write;

use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, Vec2};

use crate::{Error, Result};
#[cfg(feature = "synth")]
pub use write::write_exr;

/// Reads the depth of an image of known size: its only channel, or the only one whose name ends in `Z` or `depth`. The
/// size in the file is compared before memory is allocated.
pub fn read_exr_depth(path: &Path, resolution: [u32; 2]) -> Result<Vec<f32>> {
    let damaged = |e: exr::error::Error| Error::malformed(path, "depth map", "an EXR image", e.to_string());
    let file = super::open(path)?;
    let meta = MetaData::read_from_buffered(std::io::BufReader::new(file), false).map_err(damaged)?;
    let [w, h] = resolution.map(|side| side as usize);
    if let Some(other) = meta.headers.iter().map(|header| header.layer_size).find(|size| *size != Vec2(w, h)) {
        let found = format!("{} x {} pixels", other.width(), other.height());
        return Err(Error::malformed(path, "depth map", format!("{w} x {h} pixels"), found));
    }
    let channels = meta.headers.iter().flat_map(|header| &header.channels.list);
    let names: Vec<String> = channels.map(|channel| channel.name.to_string()).collect();
    let is_depth =
        |name: &&String| name.rsplit('.').next().is_some_and(|last| last == "Z" || last.eq_ignore_ascii_case("depth"));
    let depths: Vec<&String> = names.iter().filter(is_depth).collect();
    let name = match (&names[..], &depths[..]) {
        ([only], _) => only,
        (_, [depth]) => *depth,
        _ => {
            let expected = "one channel, or one whose name ends in `Z` or `depth`";
            return Err(Error::malformed(path, "depth map", expected, names.join(", ")));
        }
    };
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required(name.as_str())
        .collect_pixels(
            |size, _| (size.width(), vec![0.0; size.area()]),
            |(width, pixels), at, (depth,): (f32,)| pixels[at.y() * *width + at.x()] = depth,
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(damaged)?;
    Ok(image.layer_data.channel_data.pixels.1)
}
