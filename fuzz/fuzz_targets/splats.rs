#![no_main]
use octobayes_fuzz::{Kind, read};

libfuzzer_sys::fuzz_target!(|recipe: &[u8]| read(Kind::Splats, recipe));
