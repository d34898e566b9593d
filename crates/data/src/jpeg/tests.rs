use image::codecs::jpeg::JpegEncoder;

use super::*;

/// 40 x 24 pixels of libjpeg: eleven scans; a restart marker after each of six groups of blocks; four colours.
const PROGRESSIVE: &[u8] = include_bytes!("progressive.jpg");
const RESTARTS: &[u8] = include_bytes!("restarts.jpg");
const CMYK: &[u8] = include_bytes!("cmyk.jpg");

fn read(bytes: &[u8], size: [u32; 2]) -> std::result::Result<DynamicImage, String> {
    decode(Path::new("a.jpg"), "image", bytes.to_vec(), size).map_err(|e| e.to_string())
}

/// What `image` makes of it, which does not look whether it is whole.
fn trusting(bytes: &[u8]) -> DynamicImage {
    image::load_from_memory(bytes).unwrap()
}

fn sequential(size: [u32; 2], shade: impl Fn(u32, u32) -> u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let image = image::GrayImage::from_fn(size[0], size[1], |x, y| image::Luma([shade(x, y)]));
    JpegEncoder::new_with_quality(&mut bytes, 90).encode_image(&image).unwrap();
    bytes
}

/// Where the data of the last scan begin.
fn last_scan(bytes: &[u8]) -> usize {
    let at = bytes.windows(2).rposition(|pair| pair == [0xFF, 0xDA]).unwrap();
    at + 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]))
}

#[test]
fn whole_files_are_read_whatever_surrounds_the_picture() {
    let plain = sequential([37, 29], |x, y| (x * y) as u8);
    let flat = sequential([200, 3], |_, _| 0);
    let files =
        [(PROGRESSIVE, [40, 24]), (RESTARTS, [40, 24]), (CMYK, [40, 24]), (&plain, [37, 29]), (&flat, [200, 3])];
    for (bytes, size) in files {
        let expected = trusting(bytes);
        let thumbnail = [b"\xFF\xE1\x02\x02Exif\0\0".as_slice(), &[0xFF, 0xD8, 0xFF, 0xD9], &[7; 502]].concat();
        let preview = [bytes, b"\xFF\xE0".as_slice(), bytes].concat();
        for whole in [
            bytes.to_vec(),
            [&bytes[..2], &thumbnail, &bytes[2..]].concat(),
            preview,
            [bytes, &[0; 999]].concat(),
            [&bytes[..bytes.len() - 2], b"\xFF\xFF\xFF\xD9"].concat(),
            [&bytes[..bytes.len() - 2], b"\xFF\xFE\0\x05abc\xFF\xD9"].concat(),
        ] {
            assert_eq!(read(&whole, size), Ok(expected.clone()));
        }
    }
}

#[test]
fn files_that_are_cut_anywhere_are_refused() {
    let noise = sequential([64, 48], |x, y| (x * x * 31 + y * y * 17 + x * y * 7) as u8);
    for (bytes, size) in [(PROGRESSIVE, [40, 24]), (RESTARTS, [40, 24]), (&noise, [64, 48])] {
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length], size).is_err(), "{length} of {}", bytes.len());
            // Copying programs may reserve the whole file first.
            let zeros = [&bytes[..length], &vec![0; bytes.len() - length]].concat();
            assert!(read(&zeros, size).is_err(), "{length} of {}, then zeros", bytes.len());
        }
        // Programs that repair files add the end.
        let start = last_scan(bytes);
        for length in start..start + (bytes.len() - start) / 2 {
            let ended = [&bytes[..length], b"\xFF\xD9"].concat();
            assert!(read(&ended, size).is_err(), "{length} of {}, then an end", bytes.len());
        }
    }
    let error = read(&noise[..noise.len() / 2], [64, 48]).unwrap_err();
    assert!(error.ends_with(&format!("{} bytes without the end marker", noise.len() / 2)), "{error}");
}

#[test]
fn scans_and_restart_markers_that_were_lost_are_missed() {
    let scans: Vec<usize> = (0..PROGRESSIVE.len() - 1).filter(|&i| PROGRESSIVE[i..].starts_with(b"\xFF\xDA")).collect();
    assert!(scans.len() > 5);
    for end in &scans[1..] {
        let error = read(&[&PROGRESSIVE[..*end], b"\xFF\xD9"].concat(), [40, 24]).unwrap_err();
        assert!(error.contains("found an end before the last scan of component"), "{error}");
    }
    let marker = |n: u8| RESTARTS.windows(2).position(|pair| pair == [0xFF, 0xD0 + n]).unwrap();
    let without = |from: usize, to: usize| read(&[&RESTARTS[..from], &RESTARTS[to..]].concat(), [40, 24]).unwrap_err();
    for error in [without(marker(1), marker(1) + 2), without(marker(1), marker(2))] {
        assert!(error.ends_with("found 4 of 5 restart markers in a scan"), "{error}");
    }
}

#[test]
fn memory_counts_what_waits_for_the_last_scan() {
    let [sequential, progressive] =
        [RESTARTS, PROGRESSIVE].map(|bytes| working_memory(bytes, 960) - bytes.len() as u64);
    assert_eq!([sequential, progressive], [3 * 960, 9 * 960]);
}
