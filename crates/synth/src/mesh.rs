//! Triangle meshes: reading of OBJ files, placement in the scene box, smooth vertex normals.
//!
//! A placed mesh stands on the ground z = −[`HALF_HEIGHT`], with z up and centred over the origin. It is
//! scaled uniformly until it touches the cylinder of radius [`RADIUS`] or the height 2·[`HALF_HEIGHT`]. The
//! scene box is [−1, 1]³.

use std::path::Path;

use glam::DVec3;
use obj::{ObjData, ObjError};

use octobayes::{Error, Result};

/// Half the maximal height of a placed mesh; the ground lies at minus this.
pub const HALF_HEIGHT: f64 = 0.75;
/// Maximal distance of a placed mesh from the vertical axis.
pub const RADIUS: f64 = 0.75;
/// Largest rounding of positions, in lengths of the mesh: less than a step of depths of 16 bits.
const ROUNDING: f64 = 1e-5;
/// Maximal number of triangles: a scene of about 20 GB.
const MAX_FACES: usize = 100_000_000;

octobayes::choices! {
    /// The axis of the file that points up. The other two follow by rotation, so that no mesh is mirrored.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
    pub enum Up {
        X = "x", "x up, y to the right: (x, y, z) becomes (y, z, x)";
        #[default]
        Y = "y", "y up, z to the front, as in most OBJ files: (x, y, z) becomes (x, -z, y)";
        Z = "z", "z up, as in the scene: (x, y, z) stays";
    }
}

impl Up {
    /// Rotates a vector of the file so that z is up.
    fn turn(self, v: DVec3) -> DVec3 {
        match self {
            Self::X => DVec3::new(v.y, v.z, v.x),
            Self::Y => DVec3::new(v.x, -v.z, v.y),
            Self::Z => v,
        }
    }
}

/// Placement of a mesh: scene = scale · rotated + shift.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Placement {
    /// Axis of the file that points up.
    pub up: Up,
    /// Scene units per unit of the file.
    pub scale: f64,
    /// Shift in scene units.
    pub shift: [f64; 3],
}

/// Triangles with a normal per vertex. At least one triangle has a positive area.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// `[vertices]`, finite.
    vertices: Vec<DVec3>,
    /// `[vertices]`: unit normals; zero where the faces around have no area or cancel.
    normals: Vec<DVec3>,
    /// `[faces]`: indices of vertices.
    faces: Vec<[u32; 3]>,
}

impl Mesh {
    /// Makes a mesh of `vertices` and `faces` as they are. Faces without area are kept.
    ///
    /// # Errors
    /// What is wrong, as (expected, found): no faces or too many, an index out of range, a vertex that is not
    /// finite, or no face with an area.
    pub fn new(vertices: Vec<DVec3>, faces: Vec<[u32; 3]>) -> std::result::Result<Self, (String, String)> {
        if faces.is_empty() || faces.len() > MAX_FACES {
            return Err((format!("1 to {MAX_FACES} faces"), faces.len().to_string()));
        }
        if let Some(i) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(("finite coordinates".into(), format!("{} at vertex {}", vertices[i], i + 1)));
        }
        for (i, face) in faces.iter().enumerate() {
            if let Some(&k) = face.iter().find(|&&k| k as usize >= vertices.len()) {
                let found = format!("{} in face {}", u64::from(k) + 1, i + 1);
                return Err((format!("vertex numbers from 1 to {}", vertices.len()), found));
            }
        }
        if !faces.iter().any(|face| flat_normal(face.map(|i| vertices[i as usize])).is_some()) {
            return Err(("a face with an area".into(), format!("{} faces without", faces.len())));
        }
        let normals = smooth_normals(&vertices, &faces);
        Ok(Self { vertices, normals, faces })
    }

    /// Reads the positions and triangles of an OBJ file. Materials, texture coordinates and normals are ignored.
    ///
    /// # Errors
    /// If the file cannot be read, or its faces are not a mesh of triangles as [`Mesh::new`] requires.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = octobayes::io::read(path)?;
        // Only positions and faces reach the parser: anything else does not matter here, even if it is damaged or
        // in a dialect. Other lines become empty, so that line numbers hold.
        let text: Vec<u8> = String::from_utf8_lossy(&bytes)
            .lines()
            .flat_map(|line| {
                let kept = matches!(line.split_whitespace().next(), Some("v" | "f"));
                [if kept { line } else { "" }.as_bytes().to_vec(), vec![b'\n']]
            })
            .flatten()
            .collect();
        let data = ObjData::load_buf(text.as_slice()).map_err(|e| parse_error(path, e))?;
        let polygons = data.objects.iter().flat_map(|o| &o.groups).flat_map(|g| &g.polys);
        let mut faces = Vec::new();
        for polygon in polygons {
            let corners: Vec<u32> = polygon.0.iter().map(|c| u32::try_from(c.0).unwrap_or(u32::MAX)).collect();
            let face = <[u32; 3]>::try_from(corners).map_err(|corners| {
                let place = format!("face {}", faces.len() + 1);
                Error::malformed(path, place, "3 corners (triangulate the mesh)", format!("{}", corners.len()))
            })?;
            faces.push(face);
        }
        let vertices = data.position.iter().map(|v| DVec3::from(v.map(f64::from))).collect();
        let malformed = |(expected, found): (String, String)| Error::malformed(path, "mesh", expected, found);
        let mesh = Self::new(vertices, faces).map_err(malformed)?;
        let [low, high] = mesh.extent();
        let (away, length) = (low.abs().max(high.abs()).max_element(), (high - low).max_element());
        if 0.5 * away * f64::from(f32::EPSILON) > ROUNDING * length {
            let expected = "a mesh near its origin, as positions are read as f32; shift it there".into();
            return Err(malformed((expected, format!("one of length {length}, {away} away"))));
        }
        Ok(mesh)
    }

    /// The least and the largest coordinates of its vertices, without those that no face uses.
    fn extent(&self) -> [DVec3; 2] {
        let used = || self.faces.iter().flatten().map(|&i| self.vertices[i as usize]);
        [used().fold(DVec3::INFINITY, DVec3::min), used().fold(DVec3::NEG_INFINITY, DVec3::max)]
    }

    /// Rotates, scales and shifts the mesh into the scene box.
    #[must_use]
    pub fn placed(&self, up: Up) -> (Self, Placement) {
        let turned: Vec<DVec3> = self.vertices.iter().map(|&v| up.turn(v)).collect();
        // Vertices that no face uses do not count.
        let used = || self.faces.iter().flatten().map(|&i| turned[i as usize]);
        let [a, b] = self.extent().map(|corner| up.turn(corner));
        let (low, high) = (a.min(b), a.max(b));
        let middle = 0.5 * (low + high);
        let radius = used().map(|v| (v - middle).truncate().length()).fold(0.0, f64::max);
        // A face with an area has an extent along some axis, so at least one of the two quotients is finite.
        let scale = (RADIUS / radius).min(2.0 * HALF_HEIGHT / (high.z - low.z));
        let shift = -scale * middle.with_z(low.z) - HALF_HEIGHT * DVec3::Z;
        let mesh = Self {
            vertices: turned.iter().map(|&v| scale * v + shift).collect(),
            normals: self.normals.iter().map(|&n| up.turn(n)).collect(),
            faces: self.faces.clone(),
        };
        (mesh, Placement { up, scale, shift: shift.to_array() })
    }

    /// `[vertices]`: positions.
    #[must_use]
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// `[vertices]`: unit normals; zero where the faces around have no area or cancel.
    #[must_use]
    pub fn normals(&self) -> &[DVec3] {
        &self.normals
    }

    /// `[faces]`: indices of vertices.
    #[must_use]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Positions of a face's corners.
    #[must_use]
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|i| self.vertices[i as usize])
    }
}

fn parse_error(path: &Path, error: ObjError) -> Error {
    let line = |number: usize| format!("line {}", number + 1);
    match error {
        ObjError::Io(e) => Error::io(path, "cannot read")(e),
        ObjError::MalformedFaceGroup { line_number, group } => {
            Error::malformed(path, line(line_number), "vertex numbers", format!("`{group}`"))
        }
        ObjError::ZeroVertexNumber { line_number } => {
            Error::malformed(path, line(line_number), "vertex numbers from 1", "0")
        }
        ObjError::ArgumentListFailure { line_number, list } => {
            Error::malformed(path, line(line_number), "three coordinates", list)
        }
        other => Error::malformed(path, "mesh", "lines `v` and `f`", other.to_string()),
    }
}

/// Unit normal of a triangle, on the side from which its corners run anticlockwise; `None` if it has no area.
pub fn flat_normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    (b - a).cross(c - a).try_normalize()
}

/// Normals averaged over the faces around each vertex, weighted by the angle there (Thürmer, Wüthrich 1998).
///
/// Unlike a weight by area, this does not depend on how a flat part is cut into triangles.
fn smooth_normals(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; vertices.len()];
    for face in faces {
        let corner = face.map(|i| vertices[i as usize]);
        let Some(normal) = flat_normal(corner) else { continue };
        for k in 0..3 {
            let [a, b] = [1, 2].map(|step| corner[(k + step) % 3] - corner[k]);
            sums[face[k] as usize] += a.angle_between(b) * normal;
        }
    }
    sums.iter().map(|n| n.normalize_or_zero()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<Mesh> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.obj");
        std::fs::write(&path, text).unwrap();
        Mesh::read(&path)
    }

    #[test]
    fn only_positions_and_triangles_count() {
        let mesh = read(
            b"# \xff\nmtllib none.mtl\no a\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 2 0\nvt damaged\n\
              g\xc2\xa0\xc3\xa9\nusemtl m\nf 1/1/9 2/2 3//6148914691236517206\ng b\nv 5 5 5\nf -2 -3 -4\n",
        )
        .unwrap();
        assert_eq!(mesh.faces(), &[[0, 1, 2], [2, 1, 0]]);
        assert_eq!(mesh.vertices()[2], DVec3::new(0.0, 2.0, 0.0));
    }

    #[test]
    fn what_is_wrong_is_said() {
        let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n";
        let cases = [
            (String::new(), "mesh: expected 1 to 100000000 faces, found 0"),
            (v.into(), "found 0"),
            (format!("{v}f 1 2 4 3\n"), "face 1: expected 3 corners (triangulate the mesh), found 4"),
            (format!("{v}f 1 2 3\nf 1 2\n"), "face 2: expected 3 corners (triangulate the mesh), found 2"),
            (format!("{v}f 1 2 3\nf\n"), "face 2: expected 3 corners (triangulate the mesh), found 0"),
            (format!("{v}f 1 2 5\n"), "expected vertex numbers from 1 to 4, found 5 in face 1"),
            (format!("{v}f 1 2 99999999999\n"), "vertex numbers from 1 to 4"),
            (format!("{v}f 1 2 -5\n"), "vertex numbers from 1 to 4"),
            (format!("{v}f 1 2 -9223372036854775808\n"), "vertex numbers from 1 to 4"),
            (format!("{v}f 1 2 0\n"), "line 5: expected vertex numbers from 1, found 0"),
            (format!("{v}f 1 2 x\n"), "line 5: expected vertex numbers, found `x`"),
            (format!("{v}f 1 2 99999999999999999999\n"), "line 5: expected vertex numbers"),
            (format!("v 0 nan 0\n{v}f 1 2 3\n"), "expected finite coordinates"),
            (format!("{v}v 0 1e99 0\nf 1 2 3\n"), "at vertex 5"),
            (format!("{v}v 0 0\nf 1 2 3\n"), "line 5: expected three coordinates"),
            (format!("{v}v 0 0 z\nf 1 2 3\n"), "line 5: expected three coordinates"),
            (format!("{v}f 1 1 2\nf 3 3 3\n"), "expected a face with an area, found 2 faces without"),
        ];
        for (text, expected) in cases {
            let error = read(text.as_bytes()).expect_err(&text).to_string();
            assert!(error.contains(expected) && error.contains("x.obj: "), "{error}\n  should say: {expected}");
        }
        assert!(Mesh::read(Path::new("no.obj")).unwrap_err().to_string().contains("cannot read"));
    }

    #[test]
    fn meshes_that_f32_would_round_are_refused() {
        let at = |x: f64| read(format!("v {x} 0 0\nv {} 0 0\nv {x} 2 0\nf 1 2 3\n", x + 1.0).as_bytes());
        assert!(at(100.0).is_ok(), "rounded by 4e-6");
        let error = at(500_000.0).unwrap_err().to_string();
        assert!(error.contains("a mesh near its origin") && error.contains("length 2, 500001 away"), "{error}");
    }

    #[test]
    fn meshes_stand_on_the_ground_inside_the_cylinder_whatever_is_up() {
        // A tetrahedron of height 10 along z, far from the origin, and a vertex that no face uses.
        let corners = [[100.0, 0.0, 50.0], [103.0, 0.0, 50.0], [100.0, 2.0, 50.0], [100.0, 0.0, 60.0], [0.0; 3]];
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        // The axes and signs of the file for which z ends up on top.
        let sources =
            [(Up::X, [2, 0, 1], [1.0; 3]), (Up::Y, [0, 2, 1], [1.0, 1.0, -1.0]), (Up::Z, [0, 1, 2], [1.0; 3])];
        for (up, axes, signs) in sources {
            let vertices =
                corners.iter().map(|c: &[f64; 3]| DVec3::from([0, 1, 2].map(|k| signs[k] * c[axes[k]]))).collect();
            let (mesh, placement) = Mesh::new(vertices, faces.clone()).unwrap().placed(up);
            assert!((placement.scale - 0.15).abs() < 1e-12, "{up:?}: height 10 becomes 1.5");
            let top = mesh.vertices()[3];
            assert!((top - DVec3::new(-0.225, -0.15, 0.75)).abs().max_element() < 1e-12, "{up:?}: {top}");
            assert!(mesh.vertices()[..3].iter().all(|v| (v.z + HALF_HEIGHT).abs() < 1e-12), "{up:?}");
            // Not mirrored: the slanted face still faces outwards.
            assert!(mesh.normals()[1].dot(mesh.vertices()[1] - mesh.vertices()[0]) > 0.0, "{up:?}");
        }
        // Flat and wide: the radius decides.
        let flat = Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap().placed(Up::Z).0;
        let reach = flat.vertices().iter().map(|v| v.truncate().length()).fold(0.0, f64::max);
        assert!((reach - RADIUS).abs() < 1e-12);
    }

    #[test]
    fn a_flat_part_has_its_normal_however_it_is_cut() {
        // The corner of a cube: three faces of 90° each, one cut into two triangles. By symmetry
        // the normal is diagonal.
        let vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]
            .map(|v| DVec3::from(v.map(f64::from)));
        let faces = vec![[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 5, 4], [0, 4, 3], [3, 4, 6]];
        let normals = smooth_normals(&vertices, &faces);
        assert!((normals[0] + DVec3::ONE.normalize()).length() < 1e-12, "{}", normals[0]);
        // Far corners belong only to the cut square and lie in its plane.
        assert!((normals[2] + DVec3::Z).length() < 1e-12);
    }
}
