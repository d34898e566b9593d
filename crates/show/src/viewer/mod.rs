//! A viewer in one file: a model and its uncertainty, and the scripts that show it in a browser.
//!
//! `page` puts either kind of model into a page with the scripts of `web/`. A volume is a regular lattice of
//! `grid::Grid` in bricks; only bricks with matter are stored (`bricks`), packed into 3D textures (`pack`), and
//! `volume` makes cells as small as the file allows. `splats` are stored one by one. The book's chapter on `view`
//! lists the approximations.
//!
//! Of the scripts, `page.html` has the sliders, `input.js` hears them and the mouse, `main.js` sets their ranges and
//! keeps what is chosen, `panel.js` draws the legend and the histogram beside them, and the renderers draw the model.

mod bricks;
mod color;
mod fit;
mod grid;
mod march;
mod opacity;
mod pack;
mod page;
mod seen;
mod splats;
mod volume;

pub use page::Page;
pub use splats::{ShownSplats, SplatsView, write_splats_view};
pub use volume::{ShownVolume, VolumeView, write_volume};
