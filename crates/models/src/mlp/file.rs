//! The files that hold an MLP: `.safetensors`, and the checkpoints of nerf-pytorch, read without PyTorch.
//!
//! A checkpoint is a pickle, a program that builds Python objects. It is parsed here, never executed. Both files are
//! compared with the expected types and shapes before any weight is read.

use std::path::Path;

use pytorch_reader::{DType, PytorchReader};
use safetensors::{Dtype, SafeTensors};

use super::{ENCODED, HIDDEN};
use octobayes::{Error, Result};

/// Extensions of checkpoints, as PyTorch's users choose them.
const CHECKPOINTS: [&str; 4] = ["ckpt", "pt", "pth", "tar"];

/// True if the file's name is that of a PyTorch checkpoint.
pub fn is_checkpoint(path: &Path) -> bool {
    path.extension().and_then(|extension| extension.to_str()).is_some_and(|e| CHECKPOINTS.contains(&e))
}

/// Tensors by name.
pub(super) enum File<'a> {
    Safetensors(SafeTensors<'a>),
    Checkpoint(PytorchReader),
}

/// A tensor's entry in a file.
struct Found {
    is_f32: bool,
    kind: String,
    shape: Vec<usize>,
}

impl<'a> File<'a> {
    /// Reads the names, types and shapes. `bytes` are those of the file, but for a checkpoint, which is opened here.
    pub(super) fn open(path: &Path, bytes: &'a [u8]) -> Result<Self> {
        if is_checkpoint(path) {
            octobayes::io::refuse_pipe(path)?;
            let wrong = |e: pytorch_reader::PytorchError| match e {
                pytorch_reader::PytorchError::Io(e) if e.raw_os_error().is_some() => Error::io(path, "cannot read")(e),
                e => Error::malformed(path, "content", "a checkpoint of PyTorch", one_line(&e.to_string())),
            };
            return PytorchReader::new(path).map(Self::Checkpoint).map_err(wrong);
        }
        let wrong =
            |e: safetensors::SafeTensorError| Error::malformed(path, "header", "a safetensors file", e.to_string());
        SafeTensors::deserialize(bytes).map(Self::Safetensors).map_err(wrong)
    }

    /// What stands before the names of the fine network's tensors.
    fn prefix(&self) -> &'static str {
        match self {
            Self::Safetensors(_) => "fine",
            Self::Checkpoint(_) => "model_fine_state_dict",
        }
    }

    fn find(&self, name: &str) -> Option<Found> {
        match self {
            Self::Safetensors(file) => file.tensor(name).ok().map(|view| Found {
                is_f32: view.dtype() == Dtype::F32,
                kind: format!("{:?}", view.dtype()),
                shape: view.shape().to_vec(),
            }),
            Self::Checkpoint(file) => file.get(name).map(|tensor| Found {
                is_f32: tensor.dtype() == DType::F32,
                kind: format!("{:?}", tensor.dtype()),
                shape: tensor.shape().to_vec(),
            }),
        }
    }

    /// Elements of a tensor that [`Self::find`] found to be f32; the error names what is wrong with it.
    fn elements(&self, name: &str) -> std::result::Result<Vec<f32>, String> {
        match self {
            Self::Safetensors(file) => {
                let view = file.tensor(name).map_err(|e| e.to_string())?;
                Ok(view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
            }
            Self::Checkpoint(file) => {
                let tensor = file.get(name).ok_or("no such tensor")?;
                let bytes = tensor.read().map_err(|e| one_line(&e.to_string()))?;
                Ok(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_ne_bytes(*b)).collect())
            }
        }
    }

    /// Says what a file without the tensor is, if that is known.
    fn hint(&self) -> &'static str {
        match self {
            Self::Checkpoint(file) if file.tensors().keys().any(|name| name.starts_with("pipeline._model.")) => {
                " in a checkpoint of nerfstudio, which the Python package opens by its config.yml \
                 (octobayes.nerfstudio.load)"
            }
            _ => "",
        }
    }

    /// Reads `part` of `layer` of the fine network: f32, finite, of the expected shape.
    pub(super) fn tensor(&self, path: &Path, layer: &str, part: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let name = format!("{}.{layer}.{part}", self.prefix());
        let expected = format!(
            "f32 {shape:?} (a plain NeRF MLP with {} position and {} direction features)",
            ENCODED[0], ENCODED[1]
        );
        let Some(found) = self.find(&name) else {
            let found = format!("no such tensor{}", self.hint());
            return Err(Error::malformed(path, format!("tensor `{name}`"), expected, found));
        };
        if !found.is_f32 || found.shape != shape {
            let hint = if layer == "layer1" && part == "weight" && found.shape == [HIDDEN, 39] {
                "; 39 position features mark a forward-facing model in NDC space, which has no scene box: not supported"
            } else {
                ""
            };
            let found = format!("{} {:?}{hint}", found.kind, found.shape);
            return Err(Error::malformed(path, format!("tensor `{name}`"), expected, found));
        }
        let values = self
            .elements(&name)
            .map_err(|found| Error::malformed(path, format!("tensor `{name}`"), expected, found))?;
        match values.iter().position(|v| !v.is_finite()) {
            Some(i) => {
                let found = values[i].to_string();
                Err(Error::malformed(path, format!("tensor `{name}`, element {i}"), "a finite number", found))
            }
            None => Ok(values),
        }
    }
}

/// Text of another library about an untrusted file: a single line of moderate length.
fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(300).collect()
}
