//! The description of a finished field, for reports.

use serde_json::{Value, json};

use super::ErrorBudget;
use crate::uncertainty::UncertaintyField;

/// A field's record, and how far log10 U is from its limit, as JSON.
#[must_use]
pub fn facts(field: &UncertaintyField) -> Value {
    json!({
        "record": field.record(),
        "box": field.lattice().domain().bounds().map(|b| json!({
            "min": b.min().to_array(), "max": b.max().to_array(),
        })),
        "domain": field.lattice().domain(),
        "level": field.lattice().level(),
        "ray_sets": field.ray_sets(),
        "limited": !field.limits().is_unlimited(),
        "errors": ErrorBudget::of_field(field),
    })
}
