//! The program, started in a folder.

// Each test program uses a part of this.
#![allow(dead_code)]

use std::collections::BTreeMap;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use octobayes::field::ClosedForm;
use octobayes::geometry::Camera;
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::write_transforms;

/// The program with these words, in a folder.
pub fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace()).current_dir(folder);
    command
}

pub fn run(folder: &Path, args: &str) -> Output {
    command(folder, args).output().unwrap()
}

/// Exit code, stdout and stderr.
pub fn outcome(folder: &Path, args: &str) -> (Option<i32>, String, String) {
    let output = run(folder, args);
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// What is answered on stdout. Panics on failure.
pub fn good(folder: &Path, args: &str) -> String {
    let (code, answer, said) = outcome(folder, args);
    assert_eq!(code, Some(0), "{args}: {said}");
    answer
}

/// A mesh with a volume.
pub const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";

/// An octahedron around the origin, as a mesh.
pub const OCTAHEDRON: &str = "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n\
    f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";

/// Cameras on a half circle, with the names `r_0`, `r_1`, ….
pub fn cameras(count: u32, resolution: [u32; 2]) -> Vec<(String, Camera)> {
    let cameras = ClosedForm::half_circle(count, resolution).into_iter().enumerate();
    cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect()
}

/// A folder in which commands run.
pub struct Desk(tempfile::TempDir);

impl Deref for Desk {
    type Target = Path;

    fn deref(&self) -> &Path {
        self.0.path()
    }
}

impl Desk {
    pub fn empty() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// With `cameras.json`, which has `count` cameras of `side`² pixels.
    pub fn new(count: u32, side: u32) -> Self {
        let desk = Self::empty();
        write_transforms(&desk.join("cameras.json"), &cameras(count, [side; 2])).unwrap();
        desk
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.join(name), content).unwrap();
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.join(name)).unwrap()
    }

    pub fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.join(name)).unwrap()
    }

    pub fn field(&self, name: &str) -> UncertaintyField {
        UncertaintyField::read(&self.join(name)).unwrap()
    }

    pub fn command(&self, args: &str) -> Command {
        command(self, args)
    }

    /// Exit code, stdout and stderr.
    pub fn run(&self, args: &str) -> (Option<i32>, String, String) {
        outcome(self, args)
    }

    /// stdout of a command that succeeds.
    pub fn good(&self, args: &str) -> String {
        good(self, args)
    }

    /// stderr of a command that succeeds.
    pub fn said(&self, args: &str) -> String {
        let (code, _, said) = self.run(args);
        assert_eq!(code, Some(0), "{args}: {said}");
        said
    }

    /// The JSON that a command prints.
    pub fn json(&self, args: &str) -> serde_json::Value {
        serde_json::from_str(&self.good(&format!("{args} --json"))).unwrap()
    }

    /// The error of a command that is refused: exit code 2, nothing on stdout, one line that has these words, and
    /// whatever the folder held as it was.
    pub fn refused(&self, args: &str, words: &[&str]) -> String {
        let before = self.contents();
        let (code, out, said) = self.run(args);
        assert!(code == Some(2) && out.is_empty(), "{args}: {code:?}, {out}{said}");
        let errors: Vec<&str> = said.lines().filter_map(|line| line.strip_prefix("error: ")).collect();
        let &[error] = errors.as_slice() else { panic!("{args}: one error expected: {said}") };
        for word in words {
            assert!(error.contains(word), "{args}: `{word}` expected: {error}");
        }
        assert!(self.contents() == before, "{args} changed a file");
        error.to_owned()
    }

    /// Names and contents of all that lies in the folder; for links, where they lead.
    pub fn contents(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let content = |path: &Path| {
            let kind = path.symlink_metadata().unwrap().file_type();
            match (kind.is_symlink(), kind.is_file()) {
                (true, _) => std::fs::read_link(path).unwrap().into_os_string().into_encoded_bytes(),
                (_, true) => std::fs::read(path).unwrap(),
                _ => format!("{kind:?}").into_bytes(),
            }
        };
        let paths = std::fs::read_dir(&**self).unwrap().map(|entry| entry.unwrap().path());
        paths.map(|path| (path.clone(), content(&path))).collect()
    }

    pub fn files(&self) -> Vec<String> {
        self.contents().into_keys().map(|path| path.file_name().unwrap().to_str().unwrap().to_owned()).collect()
    }
}
