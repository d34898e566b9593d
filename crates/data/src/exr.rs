//! Multi-channel EXR images.

mod write;

use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel, Vec2};

use octobayes::{Error, Result};
pub use write::write_exr;

/// Reads width, height and depth of an image: its only channel, or the only one whose name ends in `Z` or `depth`. The
/// size in the file is checked before memory is allocated.
pub fn read_exr_depth(path: &Path, check: impl Fn([u32; 2]) -> Result<()>) -> Result<([u32; 2], Vec<f32>)> {
    let damaged = |e: exr::error::Error| Error::malformed(path, "depth map", "an EXR image", e.to_string());
    let file = octobayes::io::open(path)?;
    let meta = MetaData::read_from_buffered(std::io::BufReader::new(file), false).map_err(damaged)?;
    let in_pixels = |Vec2(w, h): Vec2<usize>| [w, h].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    meta.headers.iter().try_for_each(|header| check(in_pixels(header.layer_size)))?;
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
            |size, _| (size, vec![0.0; size.area()]),
            |(size, pixels), at, (depth,): (f32,)| pixels[at.y() * size.width() + at.x()] = depth,
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(damaged)?;
    let (size, depths) = image.layer_data.channel_data.pixels;
    Ok((in_pixels(size), depths))
}
