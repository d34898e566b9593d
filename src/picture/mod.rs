//! Pictures: labelled panels as PNG and plots as SVG for readers, EXR for tools.

mod panel;
mod plot;

pub use panel::{Bar, Panel, color_panel, scalar_panel, stage_sheet, write_sheet};
pub use plot::{Curve, stage_plot, write_plot};
