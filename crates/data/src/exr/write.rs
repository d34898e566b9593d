//! Images of any channels.

use std::io::{Cursor, Write};
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
};

use octobayes::io::AtomicFile;
use octobayes::{Error, Result};

/// Writes named f32 channels of shape `[height · width]` with lossless compression.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exr::read_exr_depth;

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
        // Depth is found among others, in an image of the requested size.
        let read = || read_exr_depth(&path, |_| Ok(()));
        assert_eq!(read().unwrap(), ([3, 2], depth.clone()));
        let refused = read_exr_depth(&path, |[w, h]| Err(Error::setting("size", "another", format!("{w} x {h}"))));
        assert!(refused.unwrap_err().to_string().contains("found 3 x 2"));
        write_exr(&path, [3, 2], vec![("any", depth.clone())]).unwrap();
        assert_eq!(read().unwrap().1, depth);
        write_exr(&path, [3, 2], vec![("a", depth.clone()), ("b", depth)]).unwrap();
        assert!(read().unwrap_err().to_string().contains("found a, b"));
        std::fs::write(&path, b"this is no image").unwrap();
        assert!(read().unwrap_err().to_string().contains("expected an EXR image"));
    }
}
