//! What is found out about policies, runs and machines.
//!
//! * [`evaluation`]: how well a policy does on goals it never saw, and beside the paper's;
//! * [`experiments`]: the paper's experiments, one file each; [`reproduce`] does all of them and makes a page;
//! * [`film`]: episodes as moving pictures;
//! * [`goals`]: files of goals;
//! * [`sweep`]: many trainings that differ in their configurations and seeds, and which of them is the best;
//! * [`planning`]: motions to poses that somebody asks for;
//! * [`script`]: episodes that somebody took hold of, again;
//! * [`figures`]: learning curves of runs, and the panels that everything is drawn in;
//! * [`verification`]: whether two runs, or a run and its repetition, are the same to the bit;
//! * [`mod@bench`]: how fast a machine simulates, learns and transports;
//! * [`statistics`], [`trained`], [`contender`], [`identity`], [`standalone`], [`threads`]: what these share.

pub mod bench;
pub mod contender;
mod document;
pub mod evaluation;
pub mod experiments;
pub mod figures;
pub mod film;
pub mod goals;
pub mod identity;
pub mod planning;
pub mod reproduce;
pub mod scale;
pub mod script;
pub mod standalone;
pub mod statistics;
pub mod sweep;
pub mod threads;
pub mod trained;
pub mod verification;
