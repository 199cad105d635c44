//! Episodes as moving pictures: the robot as it collides, in light, with the goals that it goes to.
//!
//! [`make`] plays an episode, poses the robot for every picture and has [`rendering`] draw it. One file a step of that: what is played
//! (`episode`), how the robot moves between control steps (`motion`), which solids it is (`bodies`), where
//! it touches (`contacts`), and what stands in a picture (`stage`).

mod bodies;
mod contacts;
mod episode;
mod look;
mod motion;
mod stage;

use std::sync::Mutex;

use proto::config::TaskName;
use proto::{ExitCode, ExitError};
use rendering::{Film, Format, Image};
use run::report::progress::Parts;
use serde::Serialize;
use simulator::executor::Executor as _;

use self::episode::Episode;
pub use self::episode::{EpisodeSettings, HandGoal};
pub use self::look::Look;
use self::stage::Stage;
use crate::identity::Identity;
use crate::threads::Threads;
use crate::trained::Trained;

/// How long a film shows its first moment and its last (ms).
const FIRST: u64 = 400;
const LAST: u64 = 1600;

/// Most pictures of a film.
const MOST: u64 = 20_000;

/// Pictures that a thread draws before they are put into the file.
const AHEAD: usize = 4;

/// Pictures by which the colours are chosen where there are few.
const EXAMPLES: u64 = 6;

/// What was made.
#[derive(Debug, Serialize)]
pub struct Made {
    /// What it was written as.
    pub format: &'static str,
    /// Columns (px).
    pub width: usize,
    /// Rows (px).
    pub height: usize,
    /// Pictures.
    pub pictures: u64,
    /// How long it lasts before it begins anew (s).
    pub duration_s: f64,
    /// Length of the file.
    pub bytes: usize,
    /// The policy that moves the robot.
    pub policy: Identity,
    /// The robot's name.
    pub robot: String,
    /// The task.
    pub task: TaskName,
    /// Seed of the goals.
    pub seed: u64,
    /// Which episode of that seed.
    pub episode: u32,
    /// Its control steps.
    pub steps: usize,
    /// What of the episode passes in a second.
    pub speed: f64,
    /// Distance of each hand from its goal after the last step (m); none where hands have no goals.
    pub position_m: Vec<f32>,
    /// Euler-angle error of each hand there (rad); likewise.
    pub orientation_rad: Vec<f32>,
    /// Attitude error of the base there (rad); none where it has no goal.
    pub attitude_rad: Option<f32>,
    /// Control steps after which bodies touch.
    pub steps_with_contact: usize,
}

/// When each picture is shown.
#[derive(Debug, Clone, Copy)]
struct Times {
    pictures: u64,
    fps: u32,
    /// Length of the episode in the film (s).
    lasts: f64,
}

impl Times {
    fn new(episode_s: f64, look: &Look) -> Result<Self, ExitError> {
        let lasts = episode_s / look.speed;
        // What is whole but for rounding is whole.
        let pictures = (lasts * f64::from(look.fps) - 1e-6).ceil().max(1.0) as u64 + 1;
        if pictures > MOST {
            let message = format!(
                "the film would have {} pictures, and {} at most; a larger --speed, a smaller \
                 --fps or fewer --steps make it shorter",
                output::grouped(pictures),
                output::grouped(MOST)
            );
            return Err(ExitError::new(ExitCode::Usage, message));
        }
        Ok(Self { pictures, fps: look.fps, lasts })
    }

    /// The share of the episode that has passed in a picture.
    fn passed(self, picture: u64) -> f64 {
        if picture + 1 == self.pictures {
            return 1.0;
        }
        (picture as f64 / f64::from(self.fps) / self.lasts).min(1.0)
    }

    /// Until when a picture is shown (ms).
    fn until(self, picture: u64) -> u64 {
        let moving = (picture + 1) * 1000 / u64::from(self.fps);
        FIRST + moving + if picture + 1 == self.pictures { LAST } else { 0 }
    }
}

/// Makes a film of an episode that a policy plays, and shows how far it has come.
pub fn make(
    trained: &Trained,
    settings: &EpisodeSettings,
    look: &Look,
    format: Format,
) -> anyhow::Result<(Vec<u8>, Made)> {
    let episode_s = settings.steps as f64 * trained.world.config.env.control_period;
    let times = Times::new(episode_s, look)?;
    let progress = Parts::new();
    progress.begin("playing the episode", settings.steps as u64);
    let episode = Episode::play(trained, settings, &|| progress.advance())?;
    let stage = Stage::new(&trained.world.robot, &episode, look);
    let threads = Threads::available();
    let draw = |picture: u64| stage.picture(times.passed(picture));
    let examples = (0..EXAMPLES.min(times.pictures)).map(|index| {
        // Spread over the film, the first and the last among them.
        index * (times.pictures - 1) / (EXAMPLES.min(times.pictures) - 1).max(1)
    });
    let examples: Vec<u64> = if format == Format::Gif { examples.collect() } else { Vec::new() };
    let begun = format!("drawing {} pictures", output::grouped(times.pictures));
    progress.begin(&begun, times.pictures + examples.len() as u64);
    let examples = drawn(threads, &examples, &draw, &|| progress.advance());
    let mut film = Film::new(format, look.size, times.pictures as u32, &examples)?;
    let pictures: Vec<u64> = (0..times.pictures).collect();
    for some in pictures.chunks(AHEAD * threads.count()) {
        let images = drawn(threads, some, &draw, &|| progress.advance());
        for (picture, image) in some.iter().zip(&images) {
            film.add(image, times.until(*picture))?;
        }
    }
    let bytes = film.finish()?;
    progress.end();
    let made = Made {
        format: format.name(),
        width: look.size[0],
        height: look.size[1],
        pictures: times.pictures,
        duration_s: times.until(times.pictures - 1) as f64 / 1000.0,
        bytes: bytes.len(),
        policy: trained.identity(),
        robot: trained.world.robot.name.clone(),
        task: trained.task(),
        seed: settings.seed,
        episode: settings.episode,
        steps: settings.steps,
        speed: look.speed,
        position_m: episode.last_errors(|errors| &errors.position),
        orientation_rad: episode.last_errors(|errors| &errors.orientation),
        attitude_rad: episode.last_attitude(),
        steps_with_contact: episode.steps_with_contact(),
    };
    Ok((bytes, made))
}

/// Pictures, drawn side by side.
fn drawn(
    threads: Threads,
    pictures: &[u64],
    draw: &(dyn Fn(u64) -> Image + Sync),
    on_picture: &(dyn Fn() + Sync),
) -> Vec<Image> {
    let images: Vec<Mutex<Option<Image>>> = pictures.iter().map(|_| Mutex::default()).collect();
    threads.run(pictures.len(), &|index| {
        let image = draw(pictures[index]);
        *images[index].lock().expect("nobody panics with it") = Some(image);
        on_picture();
    });
    let image = |slot: Mutex<Option<Image>>| {
        slot.into_inner().expect("nobody panicked with it").expect("every task ran")
    };
    images.into_iter().map(image).collect()
}

#[cfg(test)]
mod tests;
