//! A viewer in one file: a model and its uncertainty as a sparse volume, and the scripts that show it in a browser.
//!
//! The volume is a regular lattice of [`grid::Grid`] in bricks; only bricks with matter are stored ([`bricks`]), packed
//! into 3D textures ([`pack`]). [`page`] puts them into a page with the scripts of `web/`. The book's chapter on `view`
//! lists the approximations.

mod bricks;
mod color;
mod fit;
mod grid;
mod march;
mod opacity;
mod pack;
mod page;
mod seen;

pub use page::{Shown, View, write_view};
