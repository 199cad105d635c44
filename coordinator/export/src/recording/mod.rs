//! A recorded motion: MCAP for viewers, or columns.
//!
//! | topic | message |
//! |---|---|
//! | `/tf` | `foxglove.FrameTransforms`: `world`, the bodies with their names in `octopus urdf`, hands, goals |
//! | `/joint_states` | `foxglove.JointStates`: angles (rad), rates (rad/s), torques (N m) |
//! | `/joint_commands` | `foxglove.JointStates`: commanded rates (rad/s) |
//! | `/goals` | `foxglove.PosesInFrame` |
//! | `/errors` | `spaceoctopus.Errors` |
//! | `/contacts` | `spaceoctopus.Contacts` |
//!
//! There is one of each at the beginning and after every control step; time begins with the motion. The file holds the robot as
//! `robot.urdf` and `robot.toml`, everything that the motion follows from as `motion.json`, and says where it comes from as the metadata record
//! `spaceoctopus`.

mod commanded;
mod messages;
mod moments;
mod origin;
mod read;
mod schema;

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Attachment, WriteOptions, Writer, records};
use prost::Message as _;
use simulator::robot::urdf::urdf;

pub(crate) use self::commanded::numbers_of;
pub use self::commanded::{Commanded, Recorded};
use self::commanded::{MOTION, MotionFile, ROBOT};
use crate::error::ExportError;
use messages::{
    Contact, Contacts, Errors, FrameTransform, FrameTransforms, JointState, JointStates, Pose,
    PosesInFrame, Quaternion, Timestamp, Vector3,
};
use moments::{Frame, Moment, base_goal, body_names, hand_goal, moments};
use origin::ABOUT;
pub use origin::RecordedEpisode;

/// How many topics a file has.
const TOPICS: usize = 6;

/// A motion that was made to be kept.
#[derive(Debug)]
pub struct Recording {
    commanded: Commanded,
    about: BTreeMap<String, String>,
    moments: Vec<Moment>,
    /// Numbers of the states, one more than there are steps.
    states: Vec<Vec<f32>>,
}

fn vector(v: &nalgebra::Vector3<f64>) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}

fn quaternion(frame: &Frame) -> Quaternion {
    let q = frame.quaternion();
    Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }
}

impl Recording {
    /// What its file begins with, as every MCAP file does.
    pub const MARK: &[u8] = origin::MAGIC;

    /// Executes commands. `origin` says whose they are, in words for the file.
    ///
    /// # Errors
    /// If the simulation diverges.
    pub fn of(commanded: Commanded, origin: &[(&str, String)]) -> Result<Self, ExportError> {
        let own = [
            ("robot", commanded.robot.name.clone()),
            ("control_period_s", commanded.options.control_period.to_string()),
        ];
        let all = own.iter().chain(origin);
        let about = all.map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        let (moments, states) = moments(&commanded)?;
        Ok(Self { commanded, about, moments, states })
    }

    /// The goals after so many control steps: of the hands that have one, then of the base.
    fn goals(&self, step: usize) -> Vec<Frame> {
        let hands = self.commanded.hand_goals(step).iter().flatten().map(|goal| hand_goal(*goal));
        hands.chain(self.commanded.goals.base.map(base_goal)).collect()
    }

    fn period(&self) -> f64 {
        self.commanded.options.control_period
    }

    /// Nanoseconds from the beginning to a moment.
    fn nanoseconds(&self, step: usize) -> u64 {
        (step as f64 * self.period() * 1e9).round() as u64
    }

    /// The bytes of an MCAP file.
    ///
    /// # Errors
    /// If it cannot be put together.
    pub fn mcap(&self) -> Result<Vec<u8>, ExportError> {
        self.write_mcap().map_err(|error| ExportError::Recording(error.to_string()))
    }

    fn write_mcap(&self) -> mcap::McapResult<Vec<u8>> {
        let options = WriteOptions::new()
            .compression(None)
            .profile("")
            .library(concat!("SpaceOctopus ", env!("CARGO_PKG_VERSION")));
        let mut writer = Writer::with_options(Cursor::new(Vec::new()), options)?;
        writer.write_metadata(&records::Metadata {
            name: ABOUT.to_owned(),
            metadata: self.about.clone(),
        })?;
        let robot = &self.commanded.robot;
        let motion = MotionFile::new(&self.commanded, self.states.clone());
        let motion = serde_json::to_vec(&motion).expect("plain data");
        for (name, media_type, data) in [
            ("robot.urdf", "application/xml", urdf(robot).into_bytes()),
            (ROBOT, "application/toml", robot.to_toml().into_bytes()),
            (MOTION, "application/json", motion),
        ] {
            writer.attach(&Attachment {
                log_time: 0,
                create_time: 0,
                name: name.to_owned(),
                media_type: media_type.to_owned(),
                data: data.into(),
            })?;
        }
        let mut channels = Vec::new();
        for (topic, message) in [
            ("/tf", "foxglove.FrameTransforms"),
            ("/joint_states", "foxglove.JointStates"),
            ("/joint_commands", "foxglove.JointStates"),
            ("/goals", "foxglove.PosesInFrame"),
            ("/errors", "spaceoctopus.Errors"),
            ("/contacts", "spaceoctopus.Contacts"),
        ] {
            let schema = writer.add_schema(message, "protobuf", &schema::schema(message))?;
            channels.push(writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())?);
        }
        for (step, moment) in self.moments.iter().enumerate() {
            let time = self.nanoseconds(step);
            let contents = self.messages(step, time, moment);
            for (&channel_id, data) in channels.iter().zip(contents) {
                let header = MessageHeader {
                    channel_id,
                    sequence: step as u32,
                    log_time: time,
                    publish_time: time,
                };
                writer.write_to_known_channel(&header, &data)?;
            }
        }
        writer.finish()?;
        Ok(writer.into_inner().into_inner())
    }

    /// One message of each topic, in their order.
    fn messages(&self, step: usize, time: u64, moment: &Moment) -> [Vec<u8>; TOPICS] {
        let (seconds, nanos) = ((time / 1_000_000_000) as i64, (time % 1_000_000_000) as i32);
        let timestamp = Some(Timestamp { seconds, nanos });
        let names = body_names(&self.commanded.robot);
        let joint = |at: usize, position, velocity, effort| JointState {
            name: names[at + 1].clone(),
            position,
            velocity,
            effort,
        };
        let wide = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
        let number = |values: &[f32], at: usize| Some(f64::from(values[at]));
        let joints = 0..moment.q.len();
        let states = joints.clone().map(|at| {
            let [q, qd, torque] = [&moment.q, &moment.qd, &moment.torques].map(|v| number(v, at));
            joint(at, q, qd, torque)
        });
        let commands = joints.map(|at| joint(at, None, number(&moment.commands, at), None));
        let poses = self.goals(step).into_iter().map(|goal| Pose {
            position: Some(vector(&goal.origin)),
            orientation: Some(quaternion(&goal)),
        });
        let xyz = |[x, y, z]: [f64; 3]| Some(Vector3 { x, y, z });
        let contacts = moment.pushes.iter().map(|push| Contact {
            on: push.on.clone(),
            by: push.by.clone(),
            point: xyz(push.point),
            force: xyz(push.force),
        });
        [
            FrameTransforms { transforms: self.transforms(step, timestamp, moment, &names) }
                .encode_to_vec(),
            JointStates { timestamp, joints: states.collect() }.encode_to_vec(),
            JointStates { timestamp, joints: commands.collect() }.encode_to_vec(),
            PosesInFrame { timestamp, frame_id: "world".to_owned(), poses: poses.collect() }
                .encode_to_vec(),
            Errors {
                timestamp,
                position_m: wide(&moment.position_errors),
                orientation_rad: wide(&moment.orientation_errors),
                base_rad: f64::from(moment.base_error),
            }
            .encode_to_vec(),
            Contacts { timestamp, contacts: contacts.collect() }.encode_to_vec(),
        ]
    }

    fn transforms(
        &self,
        step: usize,
        timestamp: Option<Timestamp>,
        moment: &Moment,
        names: &[String],
    ) -> Vec<FrameTransform> {
        let transform = |parent: &str, child: String, frame: &Frame| FrameTransform {
            timestamp,
            parent_frame_id: parent.to_owned(),
            child_frame_id: child,
            translation: Some(vector(&frame.origin)),
            rotation: Some(quaternion(frame)),
        };
        let joints = self.commanded.robot.joints;
        let mut all = vec![transform("world", names[0].clone(), &moment.bodies[0])];
        for at in 1..names.len() {
            // A first link hangs on the base, every other one on the one before it.
            let parent = if joints.within_arm(at - 1) == 0 { 0 } else { at - 1 };
            let frame = moment.bodies[at].seen_from(&moment.bodies[parent]);
            all.push(transform(&names[parent], names[at].clone(), &frame));
        }
        let arms = &self.commanded.robot.arms;
        for (index, (arm, hand)) in arms.iter().zip(&moment.hands).enumerate() {
            let last = joints.of_arm(index).end;
            let frame = hand.seen_from(&moment.bodies[last]);
            all.push(transform(&names[last], format!("{}_hand", arm.name), &frame));
        }
        for (arm, goal) in arms.iter().zip(self.commanded.hand_goals(step)) {
            if let Some(goal) = goal {
                all.push(transform("world", format!("{}_goal", arm.name), &hand_goal(*goal)));
            }
        }
        all
    }

    /// The same as columns: time, base, joints, commands, torques, errors; one row for the beginning and for every control step.
    ///
    /// # Errors
    /// If it cannot be put together.
    pub fn csv(&self) -> Result<Vec<u8>, ExportError> {
        self.write_csv().map_err(|error| ExportError::Recording(error.to_string()))
    }

    fn write_csv(&self) -> csv::Result<Vec<u8>> {
        let robot = &self.commanded.robot;
        let names = body_names(robot);
        let base = "base_x base_y base_z base_qw base_qx base_qy base_qz base_vx base_vy base_vz base_wx base_wy base_wz";
        let mut header = vec!["t".to_owned()];
        header.extend(base.split(' ').map(str::to_owned));
        for what in ["angle_rad", "rate_rad_s", "command_rad_s", "torque_n_m"] {
            header.extend(names[1..].iter().map(|name| format!("{name}_{what}")));
        }
        for what in ["position_error_m", "orientation_error_rad"] {
            header.extend(robot.arms.iter().map(|arm| format!("{}_{what}", arm.name)));
        }
        header.extend(["base_error_rad", "pushing_contacts"].map(str::to_owned));
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(header)?;
        for (step, moment) in self.moments.iter().enumerate() {
            let parts: [&[f32]; 8] = [
                &moment.base,
                &moment.q,
                &moment.qd,
                &moment.commands,
                &moment.torques,
                &moment.position_errors,
                &moment.orientation_errors,
                &[moment.base_error],
            ];
            let time = (self.nanoseconds(step) as f64 / 1e9).to_string();
            let numbers = parts.into_iter().flatten().map(f32::to_string);
            let contacts = moment.pushes.len().to_string();
            writer.write_record([time].into_iter().chain(numbers).chain([contacts]))?;
        }
        writer.into_inner().map_err(|error| error.into_error().into())
    }

    /// Control steps, and seconds that they take.
    pub fn length(&self) -> (usize, f64) {
        let steps = self.moments.len() - 1;
        (steps, steps as f64 * self.period())
    }
}
