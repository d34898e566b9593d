//! Pictures: labelled panels as PNG, moving ones, and plots as SVG for readers, EXR for tools.

mod animation;
mod lettering;
mod panel;
mod plot;

pub use animation::write_animation;
pub use panel::{Bar, Panel, color_panel, draw_sheet, scalar_panel, stage_sheet, write_sheet};
pub use plot::{Curve, Plot, stage_plots, write_plot};
