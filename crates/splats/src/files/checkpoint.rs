//! Checkpoints of training splats, which are recognised to name the file that is read.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use zip::ZipArchive;

use octobayes::{Error, Result};

/// Bytes of a checkpoint's pickle that are looked at. Weights lie in other members of the archive.
const PICKLE_BYTES: u64 = 4 << 20;

/// Longest text that is looked at, bytes.
const LONGEST: usize = 256;
/// Least number of tensors in a checkpoint of the original code, a tuple without names.
const TENSORS: usize = 6;

/// Names that training codes give to a splat's parameters, behind the last point and without an underscore before.
const PARAMETERS: [&[&str]; 3] =
    [&["opacities", "opacity"], &["scales", "scaling"], &["quats", "rotation", "rotations", "quaternions"]];

/// The pickle of a file that PyTorch saved; `None` for any other file.
fn pickle(path: &Path) -> Option<Vec<u8>> {
    if !path.is_file() {
        return None;
    }
    let mut file = BufReader::new(File::open(path).ok()?);
    if !file.fill_buf().ok()?.starts_with(b"PK") {
        return None;
    }
    let mut archive = ZipArchive::new(file).ok()?;
    let name = archive.file_names().flatten().find(|name| name.ends_with("data.pkl"))?.to_string();
    let mut bytes = Vec::new();
    archive.by_name(&name).ok()?.take(PICKLE_BYTES).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// The texts of a pickle: opcode `X`, a length of four bytes, UTF-8; or 0x8c and a length of one byte. Other places
/// that look like these are harmless.
fn texts(pickle: &[u8]) -> Vec<&str> {
    let text = |at: usize| {
        let rest = &pickle[at + 1..];
        let (length, start) = match pickle[at] {
            b'X' => (u32::from_le_bytes(rest.get(..4)?.try_into().ok()?) as usize, 4),
            0x8c => (usize::from(*rest.first()?), 1),
            _ => return None,
        };
        std::str::from_utf8(rest.get(start..)?.get(..length.min(LONGEST))?).ok()
    };
    (0..pickle.len()).filter_map(text).collect()
}

/// Whether a pickle's last object is a tuple: opcode `t` or 0x85 to 0x87, perhaps a memo, and the end.
fn is_tuple(pickle: &[u8]) -> bool {
    let memo = match pickle {
        [.., b'q', _, b'.'] => 2,
        [.., b'r', _, _, _, _, b'.'] => 5,
        [.., 0x94, b'.'] => 1,
        _ => 0,
    };
    matches!(pickle.get(..pickle.len().saturating_sub(1 + memo)), Some([.., b't' | 0x85..=0x87]))
}

/// Refuses a checkpoint of splats by its training code, and names the `.ply` to pass in its place.
///
/// # Errors
/// If the file is one.
pub fn refuse_checkpoint(path: &Path) -> Result<()> {
    let Some(pickle) = pickle(path) else { return Ok(()) };
    let texts = texts(&pickle);
    let has = |names: &[&str]| {
        let last = |text: &str| text.rsplit('.').next().unwrap_or_default().trim_start_matches('_').to_string();
        texts.iter().any(|text| names.contains(&&*last(text)))
    };
    let is_of_splats = PARAMETERS.iter().all(|names| has(names));
    let (way, code) = if is_of_splats && texts.iter().any(|text| text.contains("_model.")) {
        ("`ns-export gaussian-splat --load-config config.yml` writes it", "nerfstudio's splatfacto")
    } else if is_of_splats && has(&["splats"]) {
        ("`simple_trainer.py` writes it with `--save_ply`, or `gsplat.export_splats`", "gsplat")
    } else if is_tuple(&pickle) && texts.iter().filter(|text| text.parse::<u32>().is_ok()).count() >= TENSORS {
        ("`point_cloud/iteration_…/point_cloud.ply` beside it, which `save_ply` writes", "the original code")
    } else if is_of_splats {
        ("the training code's `save_ply` or export writes it", "an unknown code")
    } else {
        return Ok(());
    };
    let expected = format!("the splats as `.ply`: {way}");
    Err(Error::malformed(path, "content", expected, format!("a checkpoint of Gaussian splats by {code}")))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::write::SimpleFileOptions;

    use super::*;

    fn refused(pickle: &[u8]) -> Option<String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.bin");
        let mut archive = zip::ZipWriter::new(File::create(&path).unwrap());
        archive.start_file("step/data.pkl", SimpleFileOptions::default()).unwrap();
        archive.write_all(pickle).unwrap();
        archive.finish().unwrap();
        refuse_checkpoint(&path).err().map(|error| error.to_string())
    }

    /// A dictionary of these keys, all with the value None.
    fn dictionary(keys: &[&str]) -> Vec<u8> {
        let mut pickle = b"\x80\x02}(".to_vec();
        for key in keys {
            pickle.push(b'X');
            pickle.extend((key.len() as u32).to_le_bytes());
            pickle.extend(key.as_bytes());
            pickle.push(b'N');
        }
        pickle.extend(b"u.");
        pickle
    }

    /// So many tensors by the names of their storages, and the end of a pickle.
    fn tuple(tensors: u8, end: &[u8]) -> Vec<u8> {
        let names = (0..tensors).flat_map(|i| [b'X', 1, 0, 0, 0, b'0' + i]);
        b"\x80\x02(".iter().copied().chain(names).chain(end.iter().copied()).collect()
    }

    #[test]
    fn checkpoints_of_splats_are_named_by_their_code() {
        let nerfstudio = ["means", "scales", "quats", "opacities"].map(|name| format!("_model.gauss_params.{name}"));
        let keys: Vec<&str> = nerfstudio.iter().map(String::as_str).collect();
        for (pickle, code) in [
            (dictionary(&keys), "splatfacto"),
            (dictionary(&["step", "splats", "scales", "quats", "opacities"]), "gsplat"),
            (dictionary(&["_xyz", "_scaling", "_rotation", "_opacity"]), "an unknown code"),
            (tuple(6, b"tq\x05."), "the original code"),
            (tuple(9, b"\x86q\x01."), "the original code"),
            (tuple(6, b"\x86\x94."), "the original code"),
        ] {
            let error = refused(&pickle).unwrap_or_else(|| panic!("{code}"));
            assert!(error.contains("content: expected the splats as `.ply`: ") && error.contains(code), "{error}");
        }
        for pickle in
            [dictionary(&["model_fine_state_dict", "scales", "opacity"]), dictionary(&[]), tuple(5, b"t."), vec![]]
        {
            assert_eq!(refused(&pickle), None, "{pickle:?}");
        }
        assert!(refuse_checkpoint(Path::new("none.ckpt")).is_ok());
    }
}
