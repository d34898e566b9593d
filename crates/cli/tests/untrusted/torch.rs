//! Checkpoints as PyTorch writes them: today's archive, and the stream of pickles from before 1.6.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;

use super::samples::LAYERS;

/// Names of the storages: one for each weight and each bias.
fn keys() -> impl Iterator<Item = (String, usize)> {
    LAYERS
        .iter()
        .flat_map(|&(_, outputs, inputs)| [outputs * inputs, outputs])
        .enumerate()
        .map(|(i, n)| (i.to_string(), n))
}

fn text(out: &mut Vec<u8>, text: &str) {
    out.push(b'X');
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

fn number(out: &mut Vec<u8>, number: usize) {
    out.push(b'J');
    out.extend((number as i32).to_le_bytes());
}

/// The call that rebuilds a tensor from a storage.
fn tensor(out: &mut Vec<u8>, key: &str, shape: &[usize], is_legacy: bool) {
    out.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
    text(out, "storage");
    out.extend(b"ctorch\nFloatStorage\n");
    text(out, key);
    text(out, "cpu");
    number(out, shape.iter().product());
    // Storages of old files may be views of others: none are.
    out.extend(if is_legacy { &b"NtQ"[..] } else { b"tQ" });
    number(out, 0);
    let strides = if shape.len() == 2 { vec![shape[1], 1] } else { vec![1] };
    for sizes in [shape, &strides] {
        out.push(b'(');
        sizes.iter().for_each(|&size| number(out, size));
        out.push(b't');
    }
    // No gradient wanted, no hooks.
    out.extend(b"\x89ccollections\nOrderedDict\n)RtR");
}

/// The pickled state of a run of nerf-pytorch: its fine network, and the iteration.
pub fn pickle(is_legacy: bool) -> Vec<u8> {
    let mut out = b"\x80\x02}(".to_vec();
    text(&mut out, "iter");
    number(&mut out, 199_999);
    text(&mut out, "model_fine_state_dict");
    out.extend(b"ccollections\nOrderedDict\n)R(");
    for (i, &(name, outputs, inputs)) in LAYERS.iter().enumerate() {
        for (part, shape) in [("weight", &[outputs, inputs][..]), ("bias", &[outputs])] {
            text(&mut out, &format!("{name}.{part}"));
            tensor(&mut out, &(2 * i + usize::from(part == "bias")).to_string(), shape, is_legacy);
        }
    }
    out.extend(b"uu.");
    out
}

/// An archive with this pickle. Its weights are zeros, deflated: small files are damaged where it matters.
pub fn archive(pickle: &[u8]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut member = |name: &str, bytes: &[u8]| {
        let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
        zip.start_file(format!("model/{name}"), options).expect("a member");
        zip.write_all(bytes).expect("memory");
    };
    member("data.pkl", pickle);
    member("version", b"3\n");
    for (key, length) in keys() {
        member(&format!("data/{key}"), &vec![0; 4 * length]);
    }
    zip.finish().expect("memory").into_inner()
}

/// The pickle of an archive that [`archive`] made.
pub fn pickle_of(archive: &[u8]) -> Vec<u8> {
    let mut zip = zip::ZipArchive::new(Cursor::new(archive)).expect("an archive");
    let mut pickle = Vec::new();
    std::io::copy(&mut zip.by_name("model/data.pkl").expect("a pickle"), &mut pickle).expect("memory");
    pickle
}

/// A stream of pickles: magic number, version, machine, state and names of the storages; then these.
pub fn stream() -> Vec<u8> {
    let mut out = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}(".to_vec();
    text(&mut out, "little_endian");
    out.extend(b"\x88u.");
    out.extend(pickle(true));
    out.extend(b"\x80\x02](");
    keys().for_each(|(key, _)| text(&mut out, &key));
    out.extend(b"e.");
    for (_, length) in keys() {
        out.extend((length as u64).to_le_bytes());
        out.extend(vec![0; 4 * length]);
    }
    out
}
