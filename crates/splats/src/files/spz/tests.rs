use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::*;

/// The unpacked parameters of two splats, part by part.
fn parts(version: u32, degree: u8) -> [Vec<u8>; 6] {
    let positions = if version == 1 {
        [1.0, 2.0, -3.0, 0.5, 0.0, 8.0].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect()
    } else {
        [1_i32, 2, -3, 0, 0, 8].iter().flat_map(|v| (v * 256).to_le_bytes()[..3].to_vec()).collect()
    };
    // No rotation, then a quarter turn about y: in 3 bytes, or in 4 with the largest entry w.
    let rotations = if version < 3 {
        vec![128, 128, 128, 128, 218, 128]
    } else {
        [3_u32 << 30, 3 << 30 | 511 << 10].iter().flat_map(|word| word.to_le_bytes()).collect()
    };
    let higher = 3 * (coefficients(degree) - 1);
    let sh = (0..2 * higher).map(|i| (128 + i % 64) as u8).collect();
    [positions, vec![51, 255], vec![255, 128, 0, 10, 20, 30], vec![160, 176, 0, 1, 2, 3], rotations, sh]
}

fn header(version: u32, degree: u8, flags: u8) -> Vec<u8> {
    let mut bytes = [MAGIC, &version.to_le_bytes(), &2_u32.to_le_bytes()].concat();
    bytes.extend([degree, 8, flags, 0]);
    bytes
}

/// A file of version 1 to 3, before gzip.
fn plain(version: u32, degree: u8, flags: u8) -> Vec<u8> {
    [header(version, degree, flags), parts(version, degree).concat()].concat()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A zstd frame whose content is not compressed (RFC 8878: single segment, one raw block).
fn zstd(content: &[u8]) -> Vec<u8> {
    let block = ((content.len() as u32) << 3 | 1).to_le_bytes();
    [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, content.len() as u8][..], &block[..3], content].concat()
}

/// A file of version 4 with these extensions.
fn version_4(degree: u8, flags: u8, extensions: &[u8]) -> Vec<u8> {
    let streams: Vec<(usize, Vec<u8>)> =
        parts(4, degree).iter().filter(|part| !part.is_empty()).map(|part| (part.len(), zstd(part))).collect();
    let mut bytes = header(4, degree, flags);
    bytes[15] = streams.len() as u8;
    bytes.extend((32 + extensions.len() as u32).to_le_bytes());
    bytes.extend([0; 12]);
    bytes.extend(extensions);
    for (size, stream) in &streams {
        bytes.extend((stream.len() as u64).to_le_bytes());
        bytes.extend((*size as u64).to_le_bytes());
    }
    streams.iter().for_each(|(_, stream)| bytes.extend(stream));
    bytes
}

fn read_bytes(bytes: &[u8]) -> Result<Splats> {
    read(Path::new("s.spz"), bytes)
}

fn refused(bytes: &[u8]) -> String {
    read_bytes(bytes).unwrap_err().to_string()
}

#[test]
fn all_versions_hold_the_same_splats() {
    for degree in 0..=3 {
        let files = [
            gzip(&plain(1, degree, 0)),
            gzip(&plain(2, degree, 0)),
            plain(2, degree, 0),
            gzip(&plain(3, degree, 0)),
            version_4(degree, 0, &[]),
        ];
        for (i, file) in files.iter().enumerate() {
            let splats = read_bytes(file).unwrap_or_else(|e| panic!("file {i}: {e}"));
            assert_eq!((splats.len(), splats.degree(), splats.mode()), (2, degree, RenderMode::Classic), "file {i}");
            // Up and back become down and forward.
            assert_eq!(splats.mean(0), Vec3::new(1.0, -2.0, 3.0), "file {i}");
            assert_eq!(splats.log_scales(), [Vec3::new(0.0, 1.0, -10.0), Vec3::new(1.0, 2.0, 3.0) / 16.0 - 10.0]);
            assert!((splats.opacity(0) - 0.2).abs() < 1e-6 && splats.opacity(1) > 0.99999, "file {i}");
            assert!((splats.sh(0)[0] - 0.5 / 0.15).abs() < 1e-6 && splats.sh(0)[2] < -3.3, "file {i}");
            let q = splats.rotation(1);
            assert!((q.y + 0.5_f32.sqrt()).abs() < 0.01 && (q.w - 0.5_f32.sqrt()).abs() < 0.01, "file {i}: {q}");
            if degree > 0 {
                // Red of the harmonic of y, then of z: both odd in a turned axis. That of x is not.
                let width = 3 * (coefficients(degree) - 1);
                let stored = |at: usize| ((width + at) % 64) as f32 / 128.0;
                let found = [3, 6, 9].map(|at: usize| splats.sh(1)[at]);
                assert_eq!(found, [-stored(0), -stored(3), stored(6)], "file {i}");
            }
        }
    }
}

/// Signs of the harmonics from right, up, back to right, down, forward: those that are odd in y and z together.
#[test]
fn every_harmonic_is_turned() {
    let signs = [1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1];
    let splats = read_bytes(&version_4(3, 0, &[])).unwrap();
    for i in 0..45 {
        // Stored are 0, 1, 2, … of 128, which begin anew after 64.
        let expected = signs[1 + i / 3] as f32 * ((45 + i) % 64) as f32 / 128.0;
        assert_eq!(splats.sh(1)[3 + i], expected, "coefficient {i}");
    }
}

#[test]
fn flags_state_mode_and_axes() {
    assert_eq!(read_bytes(&plain(2, 0, ANTIALIASED)).unwrap().mode(), RenderMode::Mip);
    // The axes of PLY files.
    let axes = [&0xadbe_0003_u32.to_le_bytes()[..], &4_u32.to_le_bytes(), &6_u32.to_le_bytes()].concat();
    let old = [plain(3, 0, EXTENSIONS), axes.clone()].concat();
    for file in [gzip(&old), version_4(0, EXTENSIONS, &axes)] {
        assert_eq!(read_bytes(&file).unwrap().mean(0), Vec3::new(1.0, 2.0, -3.0));
    }
    let other = [&7_u32.to_le_bytes()[..], &0_u32.to_le_bytes()].concat();
    assert!(refused(&version_4(0, EXTENSIONS, &other)).contains("found 0x00000007"));
    assert!(refused(&plain(2, 0, 4)).contains("header, flags: expected 1 (antialiased) and 2 (extensions) alone"));
}

#[test]
fn headers_that_do_not_fit_are_refused() {
    let with = |at: usize, byte: u8| {
        let mut bytes = version_4(1, 0, &[]);
        bytes[at] = byte;
        refused(&bytes)
    };
    for (at, byte, expected) in [
        (4, 5, "header, version: expected 1 to 4, found 5"),
        (11, 0xff, "header, number of splats: expected splats of at most 4194304 bytes in a file of"),
        (8, 3, "stream 0, unpacked size: expected 27 bytes, found 18"),
        (12, 4, "degree of spherical harmonics: expected 0 to 3, found 4"),
        (12, 2, "stream 5, unpacked size: expected 48 bytes, found 18"),
        (13, 25, "fractional bits: expected at most 24, found 25"),
        (15, 5, "number of streams: expected 6, found 5"),
        (16, 31, "offset of the table of streams: expected 32 to"),
        (19, 0x7f, "offset of the table of streams"),
        (39, 1, "stream 0, size: expected at most the"),
        (128, 0, "stream 0: expected a zstd stream of 18 bytes, found"),
    ] {
        let error = with(at, byte);
        assert!(error.starts_with("s.spz: ") && error.contains(expected), "byte {at}: {error}");
    }
    for bytes in [&b"NGSP"[..], b"", &version_4(0, 0, &[])[..20]] {
        assert!(refused(bytes).contains("header: expected"), "{}", refused(bytes));
    }
    assert!(refused(&gzip(&header(4, 0, 0))).contains("version: expected 1 to 3 in one stream, found 4"));
    let none = [MAGIC, &2_u32.to_le_bytes(), &[0; 8]].concat();
    assert!(refused(&none).contains("number of splats: expected at least one, found 0"));
}

#[test]
fn streams_of_another_length_are_refused() {
    let whole = plain(2, 1, 0);
    let expected = "length: expected 56 bytes after the header, found";
    for (bytes, found) in [
        (whole[..whole.len() - 1].to_vec(), "55"),
        ([&whole[..], &[0]].concat(), "57 or more"),
        (gzip(&[&whole[..], &[0; 5]].concat()), "61 or more"),
    ] {
        assert_eq!(refused(&bytes), format!("s.spz: {expected} {found}"));
    }
    let packed = gzip(&whole);
    assert!(refused(&packed[..packed.len() - 9]).contains("gzip stream: expected a whole stream, found"));
    let fourth = version_4(1, 0, &[]);
    assert!(refused(&fourth[..fourth.len() - 1]).contains("stream 5, size: expected at most the 26 bytes left"));
    assert!(refused(&[&fourth[..], &[0]].concat()).contains("nothing after the last stream, found 1 bytes"));
    let error = refused(&[&packed[..], &[0; 7]].concat());
    assert!(error.contains("length: expected nothing after the gzip stream, found 7 bytes"), "{error}");
    let error = refused(&version_4(0, 0, &[0; 4]));
    assert!(
        error.contains("header, flags: expected extensions, before the table of streams, found 4 bytes"),
        "{error}"
    );
}

/// The first stream of a file with something behind its zstd frame.
fn with_first_stream(change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut stream = zstd(&parts(4, 0)[0]);
    let mut bytes = version_4(0, 0, &[]);
    let start = 32 + 16 * 5;
    bytes.drain(start..start + stream.len());
    change(&mut stream);
    bytes[32..40].copy_from_slice(&(stream.len() as u64).to_le_bytes());
    bytes.splice(start..start, stream);
    bytes
}

#[test]
fn streams_are_checked_to_their_last_byte() {
    let error = refused(&with_first_stream(|stream| stream.push(7)));
    assert!(error.contains("stream 0: expected a zstd stream of 18 bytes, found 1 bytes behind it"), "{error}");
    let checksum = xxh64(&parts(4, 0)[0]) as u32;
    let with = |checksum: u32| {
        with_first_stream(|stream| {
            // The flag of a checksum.
            stream[4] |= 4;
            stream.extend(checksum.to_le_bytes());
        })
    };
    assert_eq!(read_bytes(&with(checksum)).unwrap(), read_bytes(&version_4(0, 0, &[])).unwrap());
    let error = refused(&with(checksum ^ 1));
    assert!(error.contains("found checksum 0x") && error.contains(" in place of 0x"), "{error}");
}

/// A stream of zeros unpacks to a thousand times its size, and splats take up to eight times as much as unpacked.
#[test]
fn small_files_hold_few_splats() {
    let count = 500_000_u32;
    let mut bytes = header(2, 0, 0);
    bytes[8..12].copy_from_slice(&count.to_le_bytes());
    bytes.resize(16 + 19 * count as usize, 0);
    let packed = gzip(&bytes);
    let error = refused(&packed);
    assert!(packed.len() < 50_000 && error.contains("splats of at most 4194304 bytes in a file of"), "{error}");
    let error = refused(&[&packed[..], &vec![0; 500_000]].concat());
    assert!(error.contains("length: expected nothing after the gzip stream, found 500000 bytes"), "{error}");
}

/// A header can state any number of splats, and a kilobyte of zstd can unpack to 32 MB.
#[test]
fn bombs_do_not_unpack() {
    // A block that repeats one byte 128 kB often, ten times; the header states 18 bytes.
    let block: Vec<u8> = [((128_u32 << 10) << 3 | 2).to_le_bytes()[..3].to_vec(), vec![7]].concat();
    let mut stream = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x58];
    (0..10).for_each(|_| stream.extend(&block));
    let last = stream.len() - block.len();
    stream[last] |= 1;
    let mut bytes = version_4(0, 0, &[]);
    let table = 32;
    let first = u64::from_le_bytes(bytes[table..table + 8].try_into().unwrap()) as usize;
    let start = table + 16 * 5;
    bytes.splice(start..start + first, stream.iter().copied());
    bytes[table..table + 8].copy_from_slice(&(stream.len() as u64).to_le_bytes());
    let error = refused(&bytes);
    assert!(error.contains("stream 0: expected 18 unpacked bytes, found 19"), "{error}");
    // A window of 2 GB.
    bytes[start + 5] = 0xa8;
    let error = refused(&bytes);
    assert!(error.contains("stream 0: expected a zstd stream of 18 bytes"), "{error}");
}
