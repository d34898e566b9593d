//! Pictures for readers: labelled panels as PNG, and plots as SVG.

mod lettering;
mod maps;
mod panel;
mod plot;

pub use maps::{write_grey8, write_grey16};
pub use panel::{Bar, Panel, color_panel, draw_sheet, scalar_panel, write_noted_sheet, write_sheet};
pub use panel::{is_own_sheet, stage_sheet};
pub use plot::{Curve, write_plot};
pub use plot::{Plot, stage_plots};
