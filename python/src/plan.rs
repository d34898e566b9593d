//! Which photograph should be taken next.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use octobayes::geometry::Aabb;
use octobayes::glam::DVec3;
use octobayes::monitor::Message;
use octobayes_next_view::{Around, GainMap, Made, NextView, Region, Report, Settings};
use octobayes_session::Candidates;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::errors::{OrRaise, Said, said};
use crate::field::Uncertainty;
use crate::options::{NUMBERS, Options, cameras, numbers};
use crate::run::Source;
use crate::work::work;

/// The ranking as JSON, the numbers of all candidates, the gain of each pixel of the first view if it is asked for, and
/// what a user should know.
type Ranked<'py> = (String, Bound<'py, PyArray2<f64>>, Option<Bound<'py, PyArray2<f32>>>, Vec<Said>);

/// Ranks candidates, or those that are made, for a model and its uncertainty. `training` are the cameras of the images
/// that were taken, if they count.
#[pyfunction]
pub fn next_view<'py>(
    py: Python<'py>,
    nerf: &Bound<'py, PyAny>,
    uncertainty: &Bound<'py, Uncertainty>,
    candidates: Option<PyReadonlyArray2<'py, f64>>,
    training: Option<PyReadonlyArray2<'py, f64>>,
    options: &Bound<'py, PyDict>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Ranked<'py>> {
    let (source, options) = (Source::new(nerf)?, Options(options));
    let given = candidates.as_ref().map(cameras).transpose()?;
    let training = training.as_ref().map(cameras).transpose()?.unwrap_or_default();
    let names = options.or("names", Vec::<String>::new())?;
    let file: Option<PathBuf> = options.get("file")?;
    let name = source.opened().map_or(String::new(), |opened| opened.name.clone());
    let made = made(&options)?;
    let defaults = Settings::default();
    let settings = defaults
        .take(options.or("take", defaults.take)?)
        .gain(options.choice("gain")?.unwrap_or_default())
        .pixels(options.or("pixels", defaults.pixels)?)
        .seed(options.or("seed", defaults.seed)?)
        .occupancy(options.or("occupancy", defaults.occupancy)?);
    let object = options.get::<[f64; 6]>("object")?.map(|ends| {
        let [a, b] = [0, 3].map(|k| DVec3::new(ends[k], ends[k + 1], ends[k + 2]));
        Aabb::new(a, b)
    });
    let object = object.transpose().or_raise()?;
    let is_mapped = options.or("map", false)?;
    let up = options.get::<[f64; 3]>("up")?.map(DVec3::from);
    if is_mapped {
        settings.gain.check_map().or_raise()?;
    }
    let field = uncertainty.get().field.clone();
    let (report, views, map, texts) = work(py, source.gate(nerf), progress, move |engine| {
        source.with(engine, |model| {
            let mut texts = Vec::new();
            let (names, views) = match (given, made) {
                (Some(views), _) => (names, views),
                (None, made) => {
                    let around = Around::like(&training, field.lattice().domain(), up)?;
                    let (names, views, buried) =
                        made.cameras(&around, field.surface(), model, field.record().march_step);
                    if buried > 0 {
                        let kind = made.kind();
                        texts.push((format!("{buried} cameras of {kind}= stand in matter and are left out"), true));
                    }
                    (names, views)
                }
            };
            let next = NextView::new(model, &field, &views);
            let contains = object.map(|bounds| move |x: DVec3| bounds.contains(x.as_vec3()));
            let next = next
                .training(&training)
                .settings(settings)
                .region(contains.as_ref().map(|contains| -> Region { contains }))
                .monitor(engine.monitor());
            let ranking = next.run()?;
            let asked = Candidates {
                model,
                model_name: &name,
                field: &field,
                file: file.as_deref(),
                names: &names,
                cameras: &views,
                training: &training,
            };
            asked.remark(&ranking, &mut |remark| texts.push(said(remark)))?;
            texts.extend(ranking.doubt().map(|doubt| said(Message::Note(doubt))));
            let first = ranking.steps.first().filter(|_| is_mapped);
            let map = first.map(|step| next.map(&views[step.index])).transpose()?;
            Ok((Report::new(&settings, &ranking, &names), views, map, texts))
        })
    })?;
    let rows = PyArray1::from_vec(py, numbers(&views)).reshape([views.len(), NUMBERS])?;
    let map = map.map(|GainMap { resolution: [width, height], gains, .. }| {
        PyArray1::from_vec(py, gains).reshape([height as usize, width as usize])
    });
    Ok((json!(report).to_string(), rows, map.transpose()?, texts))
}

/// How candidates are made if none are given.
fn made(options: &Options) -> PyResult<Made> {
    let is_upper = options.or("upper", false)?;
    let sphere = options.get("sphere")?.map(|count| Made::Sphere { count, is_upper });
    let near = options.get("near")?.map(|count| Made::Near { count });
    Ok(match sphere.or(near) {
        Some(made) => made,
        None => Made::Orbit { count: options.or("orbit", 1)? },
    })
}
