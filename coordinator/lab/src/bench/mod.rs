//! How fast this machine simulates, learns and transports.

mod arithmetic;
mod child;
mod context;
mod figures;
mod growth;
mod learner;
mod load;
mod peer;
mod physics;
mod picture;
mod processor;
mod python;
mod rollout;
mod scale;
mod study;
mod train;
mod transport;

use serde_json::Value;

use self::context::Bench;
use self::figures::Figures;
use self::load::Watch;
use self::peer::Peers;
pub use self::study::{Study, Subject, TRAINED};

/// What was measured.
#[derive(Debug)]
pub struct Measured {
    /// As a person reads it.
    pub table: String,
    /// As programs do, with what the figures depend on.
    pub json: Value,
}

/// Measures.
pub fn measure(study: &Study) -> anyhow::Result<Measured> {
    let bench = Bench::new(study)?;
    if let Some(dir) = &study.pictures {
        picture::check_all(dir, study.force, &bench.config)?;
    }
    let peers = study.peers.as_deref().map(Peers::find).transpose()?;
    let peers = peers.as_ref();
    let load = Watch::begin();
    if study.subject == Subject::Growth {
        let curves = growth::measure(&bench)?;
        let load = load.so_far();
        if let Some(dir) = &study.pictures {
            picture::draw_all(dir, &curves)?;
        }
        bench.stages.end();
        let table = bench.framed(&growth::table(&curves), &load);
        return Ok(Measured { table, json: bench.with_context(growth::to_json(&curves), &load) });
    }
    if study.subject == Subject::Scale {
        let (table, json) = scale::measure(&bench, study)?;
        bench.stages.end();
        let load = load.so_far();
        return Ok(Measured {
            table: bench.framed(&table, &load),
            json: bench.with_context(json, &load),
        });
    }
    let mut figures = Figures::default();
    let wants = |subject| study.subject == Subject::All || study.subject == subject;
    if wants(Subject::Physics) {
        physics::measure(&bench, peers, &mut figures)?;
    }
    if wants(Subject::Rollout) {
        rollout::measure(&bench, peers, &mut figures)?;
    }
    if wants(Subject::Learner) {
        learner::measure(&bench, peers, &mut figures)?;
    }
    if wants(Subject::Transport) {
        transport::measure(&bench, &mut figures)?;
    }
    if wants(Subject::Train) {
        train::measure(&bench, peers, &mut figures)?;
    }
    // It wants a Python with the wheel, which not everybody has.
    if study.subject == Subject::Python {
        python::measure(&bench, peers, &mut figures)?;
    }
    bench.stages.end();
    let load = load.so_far();
    figures.check(&load.sentence())?;
    let table = bench.framed(&figures.table(), &load);
    Ok(Measured { table, json: bench.with_context(figures.to_json(), &load) })
}
