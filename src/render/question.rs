//! What rays ask of a field, and how the questions of many rays become one.
//!
//! Rays of a field in Rust ask for themselves, a few thousand points at a time. A field that is dear to enter wants
//! more ([`RadianceField::batch`]): then groups of rays pause at their questions, and questions of a kind are asked
//! together.

use glam::Vec3;

use crate::field::{Differentiable, Radiance, RadianceField, RadianceJet};

/// Points, and room for what the field has to say of them.
pub(super) enum Question<'q> {
    /// σ.
    Densities { positions: &'q [Vec3], out: &'q mut [f32] },
    /// σ and ∇σ.
    DensityJets { positions: &'q [Vec3], densities: &'q mut [f32], gradients: &'q mut [Vec3] },
    /// σ and colour.
    Radiance { positions: &'q [Vec3], directions: &'q [Vec3], out: &'q mut [Radiance] },
    /// σ, colour and their derivatives.
    Jets { positions: &'q [Vec3], directions: &'q [Vec3], out: &'q mut [RadianceJet] },
}

/// Questions of one kind can be asked together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Densities,
    DensityJets,
    Radiance,
    Jets,
}

impl Kind {
    pub(super) const ALL: [Self; 4] = [Self::Densities, Self::DensityJets, Self::Radiance, Self::Jets];
}

/// The derivatives that a question needs were chosen with the method of differentiation.
const DERIVATIVES: &str = "only fields that differentiate themselves are asked for derivatives";

impl Question<'_> {
    pub(super) fn kind(&self) -> Kind {
        match self {
            Self::Densities { .. } => Kind::Densities,
            Self::DensityJets { .. } => Kind::DensityJets,
            Self::Radiance { .. } => Kind::Radiance,
            Self::Jets { .. } => Kind::Jets,
        }
    }

    fn positions(&self) -> &[Vec3] {
        match self {
            Self::Densities { positions, .. }
            | Self::DensityJets { positions, .. }
            | Self::Radiance { positions, .. }
            | Self::Jets { positions, .. } => positions,
        }
    }

    /// Directions, if the question has any.
    fn directions(&self) -> &[Vec3] {
        match self {
            Self::Radiance { directions, .. } | Self::Jets { directions, .. } => directions,
            Self::Densities { .. } | Self::DensityJets { .. } => &[],
        }
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.positions().len()
    }

    /// Asks the field; `analytic` are its derivatives, if they are used.
    pub(super) fn answer(self, field: &dyn RadianceField, analytic: Option<&dyn Differentiable>) {
        match self {
            Self::Densities { positions, out } => field.densities(positions, out),
            Self::DensityJets { positions, densities, gradients } => {
                analytic.expect(DERIVATIVES).density_jets(positions, densities, gradients);
            }
            Self::Radiance { positions, directions, out } => field.evaluate(positions, directions, out),
            Self::Jets { positions, directions, out } => {
                analytic.expect(DERIVATIVES).jets(positions, directions, out);
            }
        }
    }

    /// Asks several questions of one `kind` as one.
    pub(super) fn answer_together(
        mut questions: Vec<Self>,
        kind: Kind,
        field: &dyn RadianceField,
        analytic: Option<&dyn Differentiable>,
    ) {
        if questions.len() == 1 {
            questions.remove(0).answer(field, analytic);
            return;
        }
        let positions = questions.iter().map(Self::positions).collect::<Vec<_>>().concat();
        let directions = questions.iter().map(Self::directions).collect::<Vec<_>>().concat();
        let n = positions.len();
        let (mut densities, mut gradients) = (Vec::new(), Vec::new());
        let (mut radiance, mut jets) = (Vec::new(), Vec::new());
        match kind {
            Kind::Densities => densities.resize(n, 0.0),
            Kind::DensityJets => {
                densities.resize(n, 0.0);
                gradients.resize(n, Vec3::ZERO);
            }
            Kind::Radiance => radiance.resize(n, Radiance::default()),
            Kind::Jets => jets.resize(n, RadianceJet::default()),
        }
        let whole = match kind {
            Kind::Densities => Question::Densities { positions: &positions, out: &mut densities },
            Kind::DensityJets => {
                Question::DensityJets { positions: &positions, densities: &mut densities, gradients: &mut gradients }
            }
            Kind::Radiance => Question::Radiance { positions: &positions, directions: &directions, out: &mut radiance },
            Kind::Jets => Question::Jets { positions: &positions, directions: &directions, out: &mut jets },
        };
        whole.answer(field, analytic);
        let mut at = 0;
        for question in questions {
            let part = at..at + question.len();
            at = part.end;
            match question {
                Self::Densities { out, .. } => out.copy_from_slice(&densities[part]),
                Self::DensityJets { densities: d, gradients: g, .. } => {
                    d.copy_from_slice(&densities[part.clone()]);
                    g.copy_from_slice(&gradients[part]);
                }
                Self::Radiance { out, .. } => out.copy_from_slice(&radiance[part]),
                Self::Jets { out, .. } => out.copy_from_slice(&jets[part]),
            }
        }
    }
}
