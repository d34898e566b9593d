//! Groups of rays side by side, for fields that want many points at once.

use std::collections::VecDeque;

use rayon::prelude::*;

use super::{Differentiation, JacobianBuffers, Kind, Question, RaySamples, Tracer};
use crate::geometry::Ray;

/// Rays that are differentiated together, numbered from `first`.
#[derive(Debug, Clone)]
pub struct RayGroup {
    /// The rays.
    pub rays: Vec<Ray>,
    /// `[rays]`: jitter of their samples, in `[0, 1)` steps.
    pub jitter: Vec<f64>,
    /// Index of the first ray in the run.
    pub first: u64,
}

/// A group on its way.
enum Member<'t> {
    Running {
        group: RayGroup,
        buffers: Box<JacobianBuffers<'t>>,
        /// Kind and number of points of its question.
        asks: (Kind, usize),
    },
    Done(RaySamples),
}

/// Groups of rays, each at its own question to the field; questions of a kind are asked as one.
///
/// What a group gives does not depend on the others: it is what [`Tracer::jacobians`] gives for its rays.
pub struct RaysTogether<'t> {
    tracer: &'t Tracer<'t>,
    how: &'t Differentiation<'t>,
    /// In the order in which they began.
    members: VecDeque<Member<'t>>,
}

impl<'t> RaysTogether<'t> {
    /// No rays yet.
    #[must_use]
    pub fn new(tracer: &'t Tracer<'t>, how: &'t Differentiation<'t>) -> Self {
        Self { tracer, how, members: VecDeque::new() }
    }

    /// Takes further groups to their first question.
    pub fn begin(&mut self, groups: Vec<RayGroup>) {
        let (tracer, how) = (self.tracer, self.how);
        let begun = groups.into_par_iter().map(|group| {
            // Buffers that were used before would keep, in every group, room for stages that few are in at a time.
            let mut buffers = Box::default();
            tracer.begin(&group.rays, &group.jitter, how, &mut buffers);
            Self::next(tracer, how, group, buffers)
        });
        self.members.extend(begun.collect::<Vec<_>>());
    }

    /// The group at its next question, or what came of it.
    fn next(
        tracer: &Tracer<'_>,
        how: &Differentiation,
        group: RayGroup,
        mut buffers: Box<JacobianBuffers<'t>>,
    ) -> Member<'t> {
        match buffers.question(how).map(|question| (question.kind(), question.len())) {
            Some(asks) => Member::Running { group, buffers, asks },
            None => Member::Done(tracer.assemble(&group.rays, group.first, &mut buffers)),
        }
    }

    /// Points of all questions of a kind.
    fn points_of(&self, wanted: Kind) -> usize {
        let points = |member: &Member| match member {
            Member::Running { asks: (kind, points), .. } if *kind == wanted => *points,
            _ => 0,
        };
        self.members.iter().map(points).sum()
    }

    /// The kind of question with the most points.
    fn most(&self) -> (Kind, usize) {
        let points = Kind::ALL.map(|kind| (kind, self.points_of(kind)));
        points.into_iter().max_by_key(|(_, points)| *points).unwrap_or((Kind::Densities, 0))
    }

    /// Number of points that [`RaysTogether::ask`] would ask about; 0 if all groups are done.
    #[must_use]
    pub fn points(&self) -> usize {
        self.most().1
    }

    /// Asks the field, from this thread, all questions of the kind that has the most points. Their groups go on to
    /// their next questions.
    pub fn ask(&mut self) {
        let (wanted, how, tracer) = (self.most().0, self.how, self.tracer);
        let members = std::mem::take(&mut self.members);
        let is_asked = |member: &Member| matches!(member, Member::Running { asks: (kind, _), .. } if *kind == wanted);
        let mut members: Vec<_> = members.into_iter().map(|member| (is_asked(&member), member)).collect();
        let questions = members.iter_mut().filter_map(|(is_asked, member)| match member {
            Member::Running { buffers, .. } if *is_asked => buffers.question(how),
            _ => None,
        });
        Question::answer_together(questions.collect(), wanted, tracer.field, how.analytic);
        let advanced = members.into_par_iter().map(|(is_asked, member)| match member {
            Member::Running { group, mut buffers, .. } if is_asked => {
                tracer.advance(&group.rays, how, &mut buffers);
                Self::next(tracer, how, group, buffers)
            }
            other => other,
        });
        self.members.extend(advanced.collect::<Vec<_>>());
    }

    /// Number of groups.
    #[must_use]
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// Returns true if there is no group.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// Number of groups that still have questions.
    #[must_use]
    pub fn running(&self) -> usize {
        self.members.iter().filter(|member| matches!(member, Member::Running { .. })).count()
    }

    /// Number of groups at the front that are done.
    #[must_use]
    pub fn finished(&self) -> usize {
        self.members.iter().take_while(|member| matches!(member, Member::Done(_))).count()
    }

    /// The samples of the first `count` groups, or of as many as are [finished](RaysTogether::finished).
    pub fn take(&mut self, count: usize) -> Vec<RaySamples> {
        let count = count.min(self.finished());
        let samples = self.members.drain(..count).filter_map(|member| match member {
            Member::Done(samples) => Some(samples),
            Member::Running { .. } => None,
        });
        samples.collect()
    }
}
