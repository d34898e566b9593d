//! The faulty input files of `docs/errors.md`, as the program or a test would not write them.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::npz::NpzWriter;
use crate::program::outcome;
use crate::untrusted::arrays::npy;
use crate::untrusted::{Kind, forge, samples};
use octobayes::dataset::write_transforms;
use octobayes::field::ClosedForm;

/// All input files of the table.
pub struct Desk(tempfile::TempDir);

impl Desk {
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).unwrap();
    }

    pub fn run(&self, args: &str) -> (Option<i32>, String, String) {
        outcome(self.0.path(), args)
    }

    pub fn good(&self, args: &str) {
        let (code, _, err) = self.run(args);
        assert_eq!(code, Some(0), "{args}: {err}");
    }

    pub fn files(&self) -> BTreeSet<PathBuf> {
        std::fs::read_dir(self.0.path()).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    /// An archive of f32 arrays.
    fn archive(&self, name: &str, arrays: &[(&str, &[u64], f32)]) {
        let mut npz = NpzWriter::create(&self.path(name));
        for (array, shape, value) in arrays {
            npz.array(array, shape, (0..shape.iter().product::<u64>()).map(|_| *value));
        }
        npz.finish();
    }

    pub fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        let cameras = ClosedForm::half_circle(2, [16, 16]).into_iter().enumerate();
        let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
        write_transforms(&desk.path("cameras.json"), &named).unwrap();
        desk.write("points.csv", "x,y,z\n0,0,0\n");
        desk.good("uncertainty scene:ball --cameras cameras.json --level 4 --rays 600 --occupancy 16 -o field.oct");
        desk.good("export field.oct -o bare.oct");
        let resized = "--resolution 8 --seed 1 --level 4 --rays 600 --occupancy 16 -o resized.oct";
        desk.good(&format!("uncertainty scene:ball --cameras cameras.json {resized}"));
        desk.good("uncertainty scene:courtyard --level 4 --rays 600 --resolution 8 --occupancy 16 -o courtyard.oct");
        std::fs::create_dir(desk.path("folder.oct")).unwrap();
        desk.fields();
        desk.points();
        desk.models();
        desk.splats();
        desk.cameras();
        desk.samples();
        desk.meshes();
        desk.images();
        desk.checkpoints();
        desk
    }

    fn fields(&self) {
        let bytes = std::fs::read(self.path("field.oct")).unwrap();
        let end = bytes.len();
        let altered = |at: usize| {
            let mut bytes = bytes.clone();
            bytes[at] ^= 1;
            bytes
        };
        self.write("empty.oct", b"");
        self.write("short.oct", &bytes[..end - 1]);
        self.write("long.oct", [&bytes[..], b"x"].concat());
        self.write("altered.oct", altered(end - 9));
        self.write("header.oct", altered(30));
        self.good(
            "uncertainty scene:ball --cameras cameras.json --level 4 --rays 600 --occupancy 16 --error-bars 4 \
             -o bars.oct",
        );
        self.good(
            "uncertainty scene:ball --cameras cameras.json --level 4 --rays 600 --occupancy 16 --seed 1 -o seed1.oct",
        );
        let bars = forge::recipe(Kind::Field, &std::fs::read(self.path("bars.oct")).unwrap());
        let mut parts: Vec<Vec<u8>> = forge::split(&bars[1..]).into_iter().map(<[u8]>::to_vec).collect();
        // The sign of the last error.
        parts[10].last_mut().into_iter().for_each(|byte| *byte |= 0x80);
        self.write("minus.oct", forge::file(Kind::Field, &forge::join(&parts)));
        let runs = [("shard 0/2", "part0"), ("shard 1/2", "part1"), ("tile 0/4", "tile0"), ("tile 2/4", "tile2")];
        for (part, file) in runs {
            let run = "uncertainty scene:ball --cameras cameras.json --level 4 --rays 1200 --occupancy 16";
            self.good(&format!("{run} --{part} -o {file}.oct"));
        }
        let run = "uncertainty scene:ball --cameras cameras.json --level 4 --rays 6000 --seed 1 --occupancy 16";
        self.good(&format!("{run} --tile 0/4 -o other-tile.oct"));
        self.write("newer.oct", [&bytes[..8], &99_u32.to_le_bytes(), &bytes[12..]].concat());
        let recipe = forge::recipe(Kind::Field, &bytes);
        let forged = |name: &str, change: &dyn Fn(&mut Vec<Vec<u8>>)| {
            let mut parts: Vec<Vec<u8>> = forge::split(&recipe[1..]).into_iter().map(<[u8]>::to_vec).collect();
            change(&mut parts);
            self.write(name, forge::file(Kind::Field, &forge::join(&parts)));
        };
        // Correct checksums around nonsense: header, masks, deviations, ….
        forged("nan.oct", &|parts| parts[2][..4].copy_from_slice(&f32::NAN.to_le_bytes()));
        forged("masks.oct", &|parts| parts[1].push(0));
        forged("twice.oct", &|parts| {
            let ray_set = r#"{"seed":0,"shard":{"index":0,"of":1,"rays":600}}"#;
            let header = String::from_utf8(parts[0].clone()).unwrap();
            assert!(header.contains(ray_set), "{header}");
            parts[0] = header.replacen(ray_set, &format!("{ray_set},{ray_set}"), 1).into_bytes();
        });
        forged("fewer.oct", &|parts| parts[2].truncate(40));
    }

    fn points(&self) {
        self.write("words.csv", "x,y,z\n0,0,0\n1,two,3\n");
        self.write("semicolons.csv", "0.1;0.2;0.3\n");
        self.write("infinite.csv", "0,0,1e39\n");
        self.write("unnamed.csv", "a,b,c\n1,2,3\n");
        self.write("four.csv", "7,0,0,0\n");
        self.write("ragged.csv", "x,y,z\n1,2,3\n1,2,3,4\n");
        self.write("points.txt", "0,0,0\n");
        self.write("control.csv", "0,\u{1b}[2J,0\n");
        std::fs::write(self.path("pairs.npy"), npy(&[2, 2], [0.0_f32; 4])).unwrap();
        std::fs::write(self.path("flags.npy"), npy(&[1, 3], [true; 3])).unwrap();
        std::fs::write(self.path("nan.npy"), npy(&[1, 3], [0.0, f32::NAN, 0.0])).unwrap();
        std::fs::write(self.path("good.npy"), npy(&[1, 3], [0.0_f32; 3])).unwrap();
        std::fs::write(self.path("official.npy"), npy(&[27], [-1.0_f32; 27])).unwrap();
        std::fs::write(self.path("count.npy"), npy(&[28], [1.0_f32; 28])).unwrap();
        let bytes = std::fs::read(self.path("good.npy")).unwrap();
        self.write("short.npy", &bytes[..bytes.len() - 1]);
        let text = String::from_utf8_lossy(&bytes[10..bytes.len() - 12]).into_owned();
        let header = |name: &str, from: &str, to: &str| {
            let text = text.replacen(from, to, 1);
            assert!(text.contains(to));
            let length = (text.len() as u16).to_le_bytes();
            self.write(name, [&bytes[..8], &length, text.as_bytes(), &bytes[bytes.len() - 12..]].concat());
        };
        header("trillion.npy", "1, 3", "1000000000000, 3");
        header("fortran.npy", "False", "True");
    }

    fn models(&self) {
        let grid = [2, 2, 2];
        let voxels = |name: &str, density: (&[u64], f32), color: f32, corners: [f32; 6]| {
            let mut npz = NpzWriter::create(&self.path(name));
            npz.array("box", &[2, 3], corners);
            npz.array("density", density.0, (0..density.0.iter().product::<u64>()).map(|_| density.1));
            npz.array("color", &[2, 2, 2, 3], [color; 24]);
            npz.finish();
        };
        let corners = [-1.0, -1.0, -1.0, 1.0, 1.0, 1.0];
        voxels("good.npz", (&grid, 1.0), 0.5, corners);
        voxels("nan.npz", (&grid, f32::NAN), 0.5, corners);
        voxels("negative.npz", (&grid, -1.0), 0.5, corners);
        voxels("bright.npz", (&grid, 1.0), 255.0, corners);
        voxels("other.npz", (&[2, 2, 3], 1.0), 0.5, corners);
        voxels("inside_out.npz", (&grid, 1.0), 0.5, corners.map(|v| -v));
        self.write("text.npz", "this is no archive");
        self.archive("no_color.npz", &[("box", &[2, 3], 0.0), ("density", &grid, 1.0)]);
        let mut bytes = std::fs::read(self.path("good.npz")).unwrap();
        // The value 0.5 of a colour, inside the archive's last member.
        let at = bytes.windows(4).rposition(|b| b == 0.5_f32.to_le_bytes()).unwrap();
        bytes[at] ^= 1;
        self.write("altered.npz", bytes);

        let mlp = samples::of(Kind::Safetensors).remove(0);
        self.write("text.safetensors", "this is no model");
        self.write("short.safetensors", &mlp[..mlp.len() - 1]);
        let mut nan = mlp.clone();
        let end = nan.len();
        nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
        self.write("nan.safetensors", nan);
        // Weights so large that every density overflows.
        let mut huge = mlp.clone();
        let data = 8 + u64::from_le_bytes(mlp[..8].try_into().unwrap()) as usize;
        huge[data..].chunks_exact_mut(4).for_each(|weight| weight.copy_from_slice(&1e30_f32.to_le_bytes()));
        self.write("huge.safetensors", huge);
        let renamed = String::from_utf8_lossy(&mlp[8..]).replacen("fine.fc_rgb.bias", "fine.fc_rgb.blas", 1);
        self.write("renamed.safetensors", [&mlp[..8], renamed.as_bytes()].concat());

        let checkpoint = samples::of(Kind::Torch).remove(1);
        self.write("short.ckpt", &checkpoint[..checkpoint.len() - 1]);
        self.write("text.ckpt", "this is no model");
        // As long as the name that it replaces, which the file's lengths ask for.
        let mut other = checkpoint;
        let at = other.windows(21).position(|b| b == b"model_fine_state_dict").unwrap();
        other[at..at + 21].copy_from_slice(b"pipeline._model.field");
        self.write("step-000029999.ckpt", other);

        // A million units from the origin, where f32 numbers are a sixteenth apart.
        let mut far = NpzWriter::create(&self.path("far_voxels.npz"));
        far.array("box", &[2, 3], [1e6 - 1.0, 1e6 - 1.0, 1e6 - 1.0, 1e6 + 1.0, 1e6 + 1.0, 1e6 + 1.0]);
        far.array("density", &[2, 2, 2], [1.0_f32; 8]);
        far.array("color", &[2, 2, 2, 3], [0.5_f32; 24]);
        far.finish();

        let ppng = samples::of(Kind::Ppng).remove(0);
        self.write("good.ppng", &ppng);
        self.write("short.ppng", &ppng[..ppng.len() - 1]);
        let changed = |name: &str, key: &str, value: &[u8]| {
            let mut bytes = ppng.clone();
            let at = bytes.windows(key.len()).position(|b| b == key.as_bytes()).unwrap() + key.len();
            bytes[at..at + value.len()].copy_from_slice(value);
            self.write(name, bytes);
        };
        changed("type.ppng", "qff_type", &[9]);
        changed("runs.ppng", "grid_rles", &[0x9f, 0x83, 4]);
        changed("missing.ppng", "ren", b"t");
    }

    fn splats(&self) {
        let files = samples::of(Kind::Splats);
        let ply = &files[0];
        let plain = files.iter().find(|file| file.starts_with(b"NGSP\x02")).unwrap();
        self.write("text.ply", "this is no scene");
        self.write("splats.ply", ply);
        self.write("scene.sog", "PK");
        self.write("short.ply", &ply[..ply.len() - 1]);
        self.write("ascii.ply", "ply\nformat ascii 1.0\nend_header\n");
        let cloud = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
        let properties: String = cloud.iter().map(|property| format!("property {property}\n")).collect();
        let start = "ply\nformat binary_little_endian 1.0\n";
        self.write("cloud.ply", format!("{start}element vertex 0\n{properties}end_header\n"));
        self.write("moving.ply", format!("{start}element vertex 0\nproperty float trbf_center\nend_header\n"));
        self.write("mesh.ply", format!("{start}element face 1\nproperty list uchar int i\nend_header\n"));
        let names = b"X\x10\0\0\0_model.opacitiesX\x0d\0\0\0_model.scalesX\x0c\0\0\0_model.quats";
        let mut archive = zip::ZipWriter::new(std::fs::File::create(self.path("splats.ckpt")).unwrap());
        archive.start_file("step/data.pkl", zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut archive, names).unwrap();
        archive.finish().unwrap();
        let changed = |file: &[u8], old: &[u8], new: &[u8]| {
            let mut bytes = file.to_vec();
            let at = bytes.windows(old.len()).rposition(|window| window == old).unwrap();
            bytes[at..at + new.len()].copy_from_slice(new);
            bytes
        };
        self.write("mode.ply", changed(ply, b"SplatRenderMode: mip", b"SplatRenderMode: mix"));
        // The opacity and the first scale of a splat: the middle one of three, once the last is left out.
        let number = [0.5_f32.to_le_bytes(), (-3.0_f32).to_le_bytes()].concat();
        let at = ply.windows(8).rposition(|window| window == number).unwrap();
        let first = [changed(&ply[..at], &number, &f32::NAN.to_le_bytes()), ply[at..].to_vec()].concat();
        self.write("nan.ply", first);
        self.write("short.splat", [0; 31]);
        self.write("short.spz", &plain[..plain.len() - 1]);
        self.write("newer.spz", changed(plain, b"NGSP\x02", b"NGSP\x09"));
        self.write("bomb.spz", changed(plain, b"\x02\0\0\0\x01\x0c", b"\xff\xff\xff\xff"));
    }

    fn cameras(&self) {
        let opencv = |mut camera: octobayes::geometry::Camera| {
            camera.axes = glam::DMat3::from_cols(camera.axes.x_axis, -camera.axes.y_axis, -camera.axes.z_axis);
            camera
        };
        let turned = ClosedForm::half_circle(2, [16, 16]).into_iter().enumerate();
        let turned: Vec<_> = turned.map(|(i, camera)| (format!("r_{i}"), opencv(camera))).collect();
        write_transforms(&self.path("opencv.json"), &turned).unwrap();
        let half = ClosedForm::half_circle(1, [16, 16])[0];
        let turn = glam::DMat3::from_rotation_z(std::f64::consts::PI);
        let upside_down = octobayes::geometry::Camera { axes: half.axes * turn, ..half };
        write_transforms(&self.path("rolled.json"), &[("a".into(), half), ("b".into(), upside_down)]).unwrap();
        let frame = |intrinsics: &str, matrix: &str| {
            format!("{{{intrinsics}, \"frames\": [{{\"file_path\": \"a\", \"transform_matrix\": {matrix}}}]}}")
        };
        let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,3],[0,0,0,1]]";
        let angle = "\"camera_angle_x\": 0.7";
        self.write("broken.json", "{\"frames\": [\n");
        self.write("no_frames.json", "{\"camera_angle_x\": 0.7, \"frames\": []}");
        self.write("no_focal.json", frame("\"w\": 16, \"h\": 16", pose));
        self.write("no_size.json", frame("\"fl_x\": 20", pose));
        self.write("wide.json", frame("\"fl_x\": 1e-300, \"w\": 8, \"h\": 8", pose));
        let size = "\"w\": 16, \"h\": 16";
        self.write("two_lengths.json", frame(&format!("\"fl_x\": 20, {angle}, {size}"), pose));
        self.write("folded.json", frame(&format!("{angle}, \"k1\": -5"), pose));
        self.write("k3.json", frame(&format!("{angle}, \"k3\": 0.1"), pose));
        self.write("mitsuba.json", frame(&format!("{angle}, \"from_mitsuba\": true"), pose));
        self.write("listed.json", frame(&format!("{angle}, \"train_filenames\": [\"b\"]"), pose));
        self.write("equirectangular.json", frame(&format!("{angle}, \"equirectangular\": true"), pose));
        let splats =
            |rotation: &str| format!("[{{\"img_name\": \"a\", \"position\": [0, 0, 0], \"rotation\": {rotation}}}]");
        self.write("splats.json", splats("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"));
        self.write("no_rotation.json", splats("[]"));
        let key = "\"camera_to_world\": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1], \"fov\": 40";
        let path = |kind: &str| {
            let size = "\"render_width\": 16, \"render_height\": 16";
            format!("{{\"camera_type\": \"{kind}\", {size}, \"camera_path\": [{{{key}}}]}}")
        };
        self.write("camera_path.json", path("perspective"));
        self.write("equirectangular_path.json", path("equirectangular"));
        self.write("trajectory.txt", "# timestamp tx ty tz qx qy qz qw\n1305031102.1 1.3 0.6 1.6 0.6 0.6 -0.3 -0.3\n");
        self.write("matrices.json", format!("[{pose}]"));
        self.write("dataparser_transforms.json", "{\"transform\": [[1,0,0,0],[0,1,0,0],[0,0,1,0]], \"scale\": 0.4}");
        self.write("exported.json", "[{\"file_path\": \"a\", \"transform\": [[1,0,0,0],[0,1,0,0],[0,0,1,3]]}]");
        for (model, images) in [("0", 1), ("1", 2)] {
            let folder = format!("project/sparse/{model}");
            std::fs::create_dir_all(self.path(&folder)).unwrap();
            self.write(&format!("{folder}/cameras.txt"), "1 PINHOLE 16 16 20 20 8 8\n");
            let image = |i| format!("{i} 1 0 0 0 0 0 3 1 {i}.png\n\n");
            self.write(&format!("{folder}/images.txt"), (0..images).map(image).collect::<String>());
        }
        self.write("degrees.json", frame("\"camera_angle_x\": 40", pose));
        self.write("unused.json", frame("\"fl_x\": 20, \"w\": 16, \"h\": 16, \"n_frames\": 0", pose));
        self.write("singular.json", frame(angle, "[[0,0,0,1],[0,0,0,2],[0,0,0,3],[0,0,0,1]]"));
        self.write("sheared.json", frame(angle, "[[1,0,0,0],[0.5,1,0,0],[0,0,1,3],[0,0,0,1]]"));
        self.write("transposed.json", frame(angle, "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,3,1]]"));
        self.write("fisheye.json", frame("\"fl_x\": 20, \"is_fisheye\": true", pose));
        self.write("panorama.json", frame("\"fl_x\": 20, \"camera_model\": \"EQUIRECTANGULAR\"", pose));
        let own = format!("{pose}, \"camera_model\": \"OPENCV_FISHEYE\"");
        self.write("one_fisheye.json", frame("\"fl_x\": 20, \"camera_model\": \"OPENCV\"", &own));
        std::fs::create_dir(self.path("colmap")).unwrap();
        self.write("colmap/cameras.txt", "1 OPENCV_FISHEYE 16 16 20 20 8 8 0 0 0 0\n");
        self.write("colmap/images.txt", "1 1 0 0 0 0 0 3 1 a.png\n\n");
        std::fs::create_dir(self.path("rational")).unwrap();
        self.write("rational/cameras.txt", "1 FULL_OPENCV 16 16 20 20 8 8 0 0 0 0 0 0.1 0 0\n");
        self.write("rational/images.txt", "1 1 0 0 0 0 0 3 1 a.png\n\n");
        let foreign = std::fs::read_to_string(self.path("cameras.json")).unwrap().replace("r_", "foreign_");
        self.write("foreign.json", foreign);
        let scaled = std::fs::read_to_string(self.path("cameras.json")).unwrap().replacen('{', "{\"scale\": 0, ", 1);
        self.write("unscaled.json", scaled);
        self.write("huge.json", frame("\"fl_x\": 9e4, \"w\": 65536, \"h\": 65536", pose));
    }

    fn samples(&self) {
        let write = |name: &str, ray: [u64; 2], jacobian: f32, total: i64| {
            let mut npz = NpzWriter::create(&self.path(name));
            npz.array("positions", &[2, 3], [0.1_f32; 6]);
            npz.array("jacobian", &[2, 3, 3], [jacobian; 18]);
            npz.array("ray", &[2], ray);
            npz.array("rays_total", &[], [total]);
            npz.finish();
        };
        write("decreasing.npz", [5, 4], 1.0, 10);
        write("beyond.npz", [4, 50], 1.0, 10);
        write("nan_samples.npz", [4, 5], f32::NAN, 10);
        write("none_drawn.npz", [0, 0], 1.0, 0);
        let many = 65_537;
        let mut long = NpzWriter::create(&self.path("long_ray.npz"));
        long.array("positions", &[many, 3], vec![0.1_f32; 3 * many as usize]);
        long.array("jacobian", &[many, 3, 3], vec![1.0_f32; 9 * many as usize]);
        long.array("ray", &[many], vec![0_u64; many as usize]);
        long.array("rays_total", &[], [1_i64]);
        long.finish();
        write("far.npz", [0, 1], 1.0, 10);
        write("altered_samples.npz", [0, 1], 1.0, 10);
        let mut bytes = std::fs::read(self.path("altered_samples.npz")).unwrap();
        let at = bytes.windows(4).position(|b| b == 0.1_f32.to_le_bytes()).unwrap();
        bytes[at] ^= 1;
        self.write("altered_samples.npz", bytes);
        self.archive("no_positions.npz", &[("jacobian", &[2, 3, 3], 1.0)]);
        self.archive("flat_samples.npz", &[("positions", &[2, 3], 0.1), ("jacobian", &[2, 9], 1.0)]);
    }

    fn meshes(&self) {
        let corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
        self.write("quads.obj", format!("{corners}f 1 2 3 4\n"));
        self.write("beyond.obj", format!("{corners}f 1 2 9\n"));
        self.write("words.obj", format!("{corners}f 1 2 three\n"));
        self.write("points.obj", corners);
        self.write("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
        self.write("far.obj", "v 4999999 0 0\nv 5000000 0 0\nv 5000000 1 0\nf 1 2 3\n");
        self.write("nan.obj", "v 0 0 nan\nv 1 0 0\nv 1 1 0\nf 1 2 3\n");
    }

    fn images(&self) {
        let save = |name: &str, side: u32| image::RgbaImage::new(side, side).save(self.path(name)).unwrap();
        let stripes = image::RgbImage::from_fn(16, 16, |x, _| image::Rgb([255 * (x / 2 % 2) as u8; 3]));
        (0..2).for_each(|i| stripes.save(self.path(&format!("foreign_{i}.png"))).unwrap());
        save("r_0.png", 16);
        save("r_1.png", 16);
        image::RgbaImage::new(12, 8).save(self.path("r_0_small.png")).unwrap();
        save("r_0_short.png", 16);
        let bytes = std::fs::read(self.path("r_0_short.png")).unwrap();
        self.write("r_0_short.png", &bytes[..bytes.len() / 2]);
        self.write("r_0_text.png", "this is no image");

        // Opaque pictures, and depth of a tenth of white.
        let cameras = |name: &str, names: [&str; 2]| {
            let named = names.into_iter().zip(ClosedForm::half_circle(2, [16, 16]));
            let named: Vec<_> = named.map(|(name, camera)| (name.to_string(), camera)).collect();
            write_transforms(&self.path(name), &named).unwrap();
        };
        cameras("opaque.json", ["o_0", "o_1"]);
        // A photograph that a telephone has stored lying, with the orientation in its EXIF.
        cameras("turned.json", ["turned.jpg", "o_1"]);
        let upright = std::fs::read_to_string(self.path("turned.json")).unwrap().replace("\"h\": 16", "\"h\": 24");
        self.write("turned.json", upright);
        image::RgbImage::new(24, 16).save(self.path("turned.jpg")).unwrap();
        let mut bytes = std::fs::read(self.path("turned.jpg")).unwrap();
        let exif = b"\xff\xe1\x00\x22Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        bytes.splice(2..2, *exif);
        self.write("turned.jpg", bytes);
        cameras("twice.json", ["front/o_0", "back/o_0"]);
        cameras("same.json", ["o_0", "./o_0"]);
        let masked = std::fs::read_to_string(self.path("opaque.json")).unwrap();
        self.write("clear.json", masked.replace("\"file_path\"", "\"mask_path\": \"r_0.png\", \"file_path\""));
        self.write("grey.json", masked.replace("\"file_path\"", "\"mask_path\": \"grey.png\", \"file_path\""));
        image::GrayImage::from_fn(16, 16, |x, _| image::Luma([1 + x as u8])).save(self.path("grey.png")).unwrap();
        self.write("cut.json", masked.replace("\"file_path\"", "\"mask_path\": \"cut.jpg\", \"file_path\""));
        image::GrayImage::new(16, 16).save(self.path("cut.jpg")).unwrap();
        let whole = std::fs::read(self.path("cut.jpg")).unwrap();
        std::fs::write(self.path("cut.jpg"), &whole[..whole.len() - 2]).unwrap();
        self.write("large.json", masked.replace("\"file_path\"", "\"mask_path\": \"large.png\", \"file_path\""));
        let white = image::ImageBuffer::from_pixel(512, 512, image::Rgb([u16::MAX; 3]));
        white.save(self.path("large.png")).unwrap();
        let false_colours = image::RgbImage::from_pixel(16, 16, image::Rgb([51, 204, 102]));
        false_colours.save(self.path("r_0_false.png")).unwrap();
        for name in ["o_0", "o_1"] {
            image::RgbImage::new(16, 16).save(self.path(&format!("{name}.png"))).unwrap();
            let far = image::ImageBuffer::from_pixel(16, 16, image::Luma([6554_u16]));
            far.save(self.path(&format!("{name}_far.png"))).unwrap();
        }
        let metric = "--scale data --noise 0.0316 --keep-sums --level 4 --rays 600 --occupancy 16 -o metric.oct";
        self.good(&format!("uncertainty scene:ball --cameras cameras.json {metric}"));
    }

    fn checkpoints(&self) {
        self.write("text.chk", "this is no checkpoint of a run, but more than twenty bytes");
        let octree = samples::of(Kind::Checkpoint).swap_remove(0);
        self.write("other.chk", &octree);
        self.write("short.chk", &octree[..octree.len() - 1]);
    }
}
