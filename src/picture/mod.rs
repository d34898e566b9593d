//! Pictures for people: labelled panels as PNG, plots as SVG; and EXR for tools.

mod panel;
mod plot;

pub use panel::{Bar, Panel, color_panel, scalar_panel, write_sheet};
pub use plot::{Curve, write_plot};
