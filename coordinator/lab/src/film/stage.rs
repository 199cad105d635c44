//! What stands in a picture: the robot in its colours, goals, trails, contacts, a caption.

use drawing::palette::{self, COLORS};
use nalgebra::Matrix3;
use rendering::{Body, Camera, Color, Font, Image, Overlay, Scene, Solid, Vector, View, render};
use simulator::experiment::Pose;
use simulator::robot::Robot;
use simulator::spatial::euler_xyz_to_rotation;

use super::bodies::{Frame, Kind, Posed};
use super::contacts;
use super::episode::Episode;
use super::look::Look;
use super::motion::pose_at;

/// What is behind the robot: nearly white, so that it stands as well on a dark page as on a light one.
const GROUND: [u8; 3] = [246, 247, 249];
/// Of the base, of what joins arms to it, of tubes and of hands; joints have the colour of their arm.
const BASE: [u8; 3] = [94, 107, 122];
const FOOT: [u8; 3] = [150, 158, 166];
const TUBE: [u8; 3] = [226, 229, 232];
const HAND: [u8; 3] = [58, 66, 74];
/// Of the axes x, y and z.
const AXES: [[u8; 3]; 3] = [[214, 57, 53], [46, 150, 62], [38, 92, 205]];
/// Of contacts.
const TOUCH: [u8; 3] = [233, 30, 99];

/// A capsule at least so many radii long is a tube.
const LONG: f64 = 3.0;
/// Where the line on the base's faces runs (m).
const SEAM: f64 = 0.06;
/// Length and width of a goal's axes, of a hand's, and radius of the ring around a goal (m).
const GOAL: [f64; 2] = [0.20, 0.014];
const OWN: [f64; 2] = [0.11, 0.008];
const RING: f64 = 0.06;
/// Length of the base's axes (m).
const BASE_AXES: f64 = 0.95;
/// What of goals and trails is seen through the robot.
const THROUGH: f32 = 0.22;
/// Points of a trail in a control step; their width (m) and cover at first; seconds of the film in which it fades to a third.
const TRAIL_POINTS: usize = 4;
const TRAIL_WIDTH: f64 = 0.012;
const TRAIL_COVER: f64 = 0.8;
const TRAIL_FADES: f64 = 2.2;
/// Seconds of the film in which the ring around a new contact grows and fades.
const FLASH: f64 = 0.8;
/// Poses by which the camera is placed.
const LOOKS: usize = 60;

/// Everything that all pictures of a film share.
#[derive(Debug)]
pub(super) struct Stage<'a> {
    robot: &'a Robot,
    episode: &'a Episode,
    look: &'a Look,
    camera: Camera,
    /// What the camera goes around (m).
    pivot: Vector,
    /// Seconds of the film in a control step.
    step_s: f64,
    /// Where each hand was: `[arm][control step · TRAIL_POINTS]` (m).
    trails: Vec<Vec<Vector>>,
    /// The control steps after which new contacts were there, and where (m).
    flashes: Vec<(usize, Vec<Vector>)>,
    font: Font,
}

impl<'a> Stage<'a> {
    pub(super) fn new(robot: &'a Robot, episode: &'a Episode, look: &'a Look) -> Self {
        let steps = episode.poses.len() - 1;
        let posed = |at: f64| Posed::new(robot, &pose_at(&episode.poses, at));
        let mut trails = vec![Vec::new(); robot.n_arms];
        for point in 0..=steps * TRAIL_POINTS {
            let hands = posed(point as f64 / TRAIL_POINTS as f64).hands;
            for (trail, hand) in trails.iter_mut().zip(hands) {
                trail.push(hand.origin);
            }
        }
        let flashes = (1..=steps).filter_map(|step| {
            let (before, now) = (episode.contacts[step - 1], episode.contacts[step]);
            let more = (0..now.len()).any(|kind| now[kind] > before[kind]);
            more.then(|| (step, contacts::places(&posed(step as f64), &now)))
        });
        let (camera, pivot) = placed(robot, episode, look);
        Self {
            robot,
            episode,
            look,
            camera,
            pivot,
            step_s: episode.control_period / look.speed,
            trails,
            flashes: flashes.collect(),
            font: Font::default(),
        }
    }

    /// The picture when a share of the episode has passed.
    pub(super) fn picture(&self, passed: f64) -> Image {
        let view = self.view(passed);
        let camera = match self.look.orbit {
            0.0 => self.camera.clone(),
            _ => self.camera.turned(&self.pivot, view),
        };
        let mut image = render(&self.scene(passed), &camera);
        if self.look.caption {
            self.write_caption(&mut image, passed);
        }
        image
    }

    /// From where it is seen, if the camera does not move.
    #[cfg(test)]
    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    fn view(&self, passed: f64) -> View {
        let View { azimuth, elevation } = self.look.view;
        View { azimuth: azimuth + self.look.orbit * passed, elevation }
    }

    /// Control steps that have passed, not always whole.
    fn steps(&self, passed: f64) -> f64 {
        passed * (self.episode.poses.len() - 1) as f64
    }

    fn scene(&self, passed: f64) -> Scene {
        let steps = self.steps(passed);
        let posed = Posed::new(self.robot, &pose_at(&self.episode.poses, steps));
        let mut scene = Scene::new(GROUND, self.look.view);
        for (index, part) in posed.parts.iter().enumerate() {
            scene.bodies.extend(part.solids.iter().map(|solid| Body {
                solid: solid.clone(),
                color: Color::srgb(surface(part.kind, solid)),
                part: index,
                seam: (part.kind == Kind::Base).then_some(SEAM),
            }));
        }
        let overlays = &mut scene.overlays;
        for (arm, trail) in self.trails.iter().enumerate() {
            overlays.push(self.trail(arm, trail, steps, &posed));
        }
        if let Some(goal) = self.episode.base {
            let goal = Frame { origin: posed.base.origin, rotation: rotation(goal) };
            overlays.extend(axes(&goal, [BASE_AXES, GOAL[1]], 0.5));
            overlays.extend(axes(&posed.base, [BASE_AXES, OWN[1]], 1.0));
        }
        let goals = self.episode.hands.get(steps.round() as usize).map_or(&[][..], Vec::as_slice);
        for &(arm, [x, y, z, euler @ ..]) in goals {
            let goal = Frame { origin: Vector::new(x, y, z), rotation: rotation(euler) };
            overlays.extend(axes(&goal, GOAL, 1.0));
            overlays.push(Overlay::Ring {
                centre: goal.origin,
                radius: RING,
                width: GOAL[1],
                color: arm_color(arm),
                cover: 1.0,
                behind: THROUGH,
            });
        }
        if !goals.is_empty() {
            overlays.extend(posed.hands.iter().flat_map(|hand| axes(hand, OWN, 1.0)));
        }
        overlays.extend(self.touches(steps, &posed));
        scene
    }

    /// The way of a hand up to now, the older the fainter.
    fn trail(&self, arm: usize, trail: &[Vector], steps: f64, posed: &Posed) -> Overlay {
        let until = ((steps * TRAIL_POINTS as f64) as usize).min(trail.len() - 1);
        let cover = |point: f64| {
            let age = (steps - point / TRAIL_POINTS as f64) * self.step_s;
            (TRAIL_COVER * (-age / TRAIL_FADES).exp()) as f32
        };
        let points = trail.iter().enumerate().take(until + 1);
        let mut points: Vec<(Vector, f32)> = points
            .map(|(index, at)| (*at, cover(index as f64)))
            .filter(|(_, cover)| *cover > 0.02)
            .collect();
        points.push((posed.hands[arm].origin, cover(steps * TRAIL_POINTS as f64)));
        Overlay::Path { points, width: TRAIL_WIDTH, color: arm_color(arm), behind: THROUGH }
    }

    /// Dots where bodies touch now, and rings around contacts that are new.
    fn touches(&self, steps: f64, posed: &Posed) -> Vec<Overlay> {
        let now = self.episode.contacts[steps.round() as usize];
        let color = Color::srgb(TOUCH);
        let circle = |centre: Vector, radius: f64, width: f64, cover: f64| Overlay::Ring {
            centre,
            radius,
            width,
            color,
            cover: cover as f32,
            behind: 0.7,
        };
        let mut touches: Vec<Overlay> = contacts::places(posed, &now)
            .into_iter()
            .map(|place| circle(place, 0.0, 0.045, 0.9))
            .collect();
        for (step, places) in &self.flashes {
            let age = (steps - *step as f64) * self.step_s / FLASH;
            if (0.0..1.0).contains(&age) {
                let grown = 1.0 - (1.0 - age).powi(2);
                let rings = places.iter();
                touches.extend(
                    rings.map(|place| circle(*place, 0.03 + 0.15 * grown, 0.014, 1.0 - age)),
                );
            }
        }
        touches
    }

    /// Time on the left, errors on the right.
    fn write_caption(&self, image: &mut Image, passed: f64) {
        let [width, height] = [image.width, image.height].map(|side| side as f32);
        let size = (0.034 * width.min(height)).max(9.0);
        let margin = (0.9 * size).round();
        let base = (height - margin).round();
        let steps = self.steps(passed);
        let ink = Color::srgb(palette::INK.bytes());
        let faint = Color::srgb(palette::FAINT.bytes());
        let time = format!("{:.1} s", steps * self.episode.control_period);
        // As wide as the longest time, so that what follows stands still.
        let longest = self.steps(1.0) * self.episode.control_period;
        let room = self.font.width(&format!("{longest:.1} s"), size);
        let left = margin + room - self.font.width(&time, size);
        self.font.write(image, &time, [left, base], size, ink);
        let speed = format!("{}×", self.look.speed);
        let small = 0.8 * size;
        self.font.write(image, &speed, [margin + room + 0.5 * size, base], small, faint);
        let errors = self.errors(steps);
        let right = width - margin - self.font.width(&errors, size);
        self.font.write(image, &errors, [right, base], size, ink);
    }

    /// The errors that the last control step left, those of hands in the mean.
    fn errors(&self, steps: f64) -> String {
        let Some(step) = ((steps + 1e-9) as usize).checked_sub(1) else { return String::new() };
        let errors = &self.episode.errors[step.min(self.episode.errors.len() - 1)];
        let mean = |of: &[f32]| 1e3 * of.iter().sum::<f32>() / of.len().max(1) as f32;
        let number = |value: f32| {
            if value < 9.95 { format!("{value:.1}") } else { format!("{value:.0}") }
        };
        let mut words = Vec::new();
        if !errors.position.is_empty() {
            words.push(format!("{} mm", number(mean(&errors.position))));
            words.push(format!("{} mrad", number(mean(&errors.orientation))));
        }
        if let Some(attitude) = errors.attitude {
            words.push(format!("{} mrad", number(1e3 * attitude)));
        }
        words.join("  ·  ")
    }
}

/// Where the camera stands, so that all of the episode is seen, and what it goes around.
fn placed(robot: &Robot, episode: &Episode, look: &Look) -> (Camera, Vector) {
    let stride = episode.poses.len().div_ceil(LOOKS);
    let poses = episode.poses.iter().step_by(stride).chain(episode.poses.last());
    let of_pose = |pose: &Pose| {
        let parts = Posed::new(robot, pose).parts;
        parts.into_iter().flat_map(|part| part.solids).flat_map(|solid| solid.balls())
    };
    let goals = episode.hands.iter().step_by(stride).flatten();
    let goals = goals.map(|(_, goal)| (Vector::new(goal[0], goal[1], goal[2]), GOAL[0]));
    let mut balls: Vec<(Vector, f64)> = poses.flat_map(of_pose).chain(goals).collect();
    if episode.base.is_some() {
        let around = episode.poses.iter().step_by(stride);
        balls.extend(
            around.map(|pose| (Vector::from(pose.base_position.map(f64::from)), BASE_AXES)),
        );
    }
    let pivot = Vector::from(robot.home_position);
    if look.orbit != 0.0 {
        // As large as from every side.
        let reach = balls.iter().map(|(at, radius)| (at - pivot).norm() + radius);
        balls = vec![(pivot, reach.fold(0.0, f64::max))];
    }
    let margin = 0.04 * look.size[0].min(look.size[1]) as f64;
    let camera = Camera::fit(look.view, look.size, margin, &balls);
    (camera.zoomed(look.zoom), pivot)
}

/// The colour of an arm, of its goal and of its trail.
pub(super) fn arm_color(arm: usize) -> Color {
    Color::srgb(COLORS[arm % COLORS.len()].bytes())
}

/// The colour of a solid of a body.
fn surface(kind: Kind, solid: &Solid) -> [u8; 3] {
    match (kind, solid) {
        (Kind::Base, _) => BASE,
        (Kind::Foot { .. }, _) => FOOT,
        (Kind::Link { is_last: true, .. }, _) => HAND,
        (_, Solid::Capsule { from, to, radius }) if (to - from).norm() > LONG * radius => TUBE,
        (Kind::Link { arm, .. }, _) => COLORS[arm % COLORS.len()].bytes(),
    }
}

fn rotation(euler: [f64; 3]) -> Matrix3<f64> {
    let rows = euler_xyz_to_rotation(euler);
    Matrix3::from_fn(|i, j| rows[i][j])
}

/// The axes of a frame, of a length and a width (m).
fn axes(frame: &Frame, [length, width]: [f64; 2], cover: f32) -> impl Iterator<Item = Overlay> {
    let Frame { origin, rotation } = *frame;
    (0..3).map(move |axis| Overlay::Path {
        points: vec![(origin, cover), (origin + rotation.column(axis) * length, cover)],
        width,
        color: Color::srgb(AXES[axis]),
        behind: THROUGH,
    })
}
