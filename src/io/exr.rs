//! Multi-channel EXR images.

use std::io::{Cursor, Write};
use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, ReadChannels, ReadLayers,
    ReadSpecificChannel, SmallVec, Vec2, WritableImage,
};

use crate::io::AtomicFile;
use crate::{Error, Result};

/// Writes named f32 channels of shape `[height · width]` with lossless compression.
///
/// # Errors
/// If the file cannot be written.
pub fn write_exr(path: &Path, [width, height]: [u32; 2], channels: Vec<(&str, Vec<f32>)>) -> Result<()> {
    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> =
        channels.into_iter().map(|(name, samples)| AnyChannel::new(name, FlatSamples::F32(samples))).collect();
    let layer = Layer::new(
        (width as usize, height as usize),
        LayerAttributes::default(),
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels),
    );
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::malformed(path, "image", "an encodable EXR", e.to_string()))?;
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes.get_ref()).map_err(Error::io(path, "cannot write"))?;
    file.commit()
}

/// Reads the depth of an image of known size: its only channel, or the only one whose name ends in `Z` or `depth`. The
/// size in the file is compared before memory is allocated.
///
/// # Errors
/// If the file is missing or damaged, its size differs, or no channel or several could be meant.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_read_back_under_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.exr");
        let depth = vec![1.0, 2.0, 3.5, 4.0, 5.0, 6.0];
        write_exr(&path, [3, 2], vec![("depth.Z", depth.clone()), ("R", vec![0.5; 6])]).unwrap();
        let image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
        let found = |name: &str| {
            let channel = image.layer_data.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
            channel.sample_data.values_as_f32().collect::<Vec<_>>()
        };
        assert_eq!((found("depth.Z"), found("R")), (depth.clone(), vec![0.5; 6]));
        // Depth is found among others, in an image of the size that is asked for.
        assert_eq!(read_exr_depth(&path, [3, 2]).unwrap(), depth);
        assert!(read_exr_depth(&path, [2, 3]).unwrap_err().to_string().contains("found 3 x 2 pixels"));
        write_exr(&path, [3, 2], vec![("any", depth.clone())]).unwrap();
        assert_eq!(read_exr_depth(&path, [3, 2]).unwrap(), depth);
        write_exr(&path, [3, 2], vec![("a", depth.clone()), ("b", depth)]).unwrap();
        assert!(read_exr_depth(&path, [3, 2]).unwrap_err().to_string().contains("found a, b"));
        std::fs::write(&path, b"this is no image").unwrap();
        assert!(read_exr_depth(&path, [3, 2]).unwrap_err().to_string().contains("expected an EXR image"));
    }
}
