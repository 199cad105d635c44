//! The messages of a recording: those of Foxglove's schemas that viewers know, and two of ours.
//!
//! Written by hand with the derives of prost; [`super::schema`] describes the same to whoever reads a file.

use prost::Message;

/// Time since the episode began.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Timestamp {
    #[prost(int64, tag = "1")]
    pub(super) seconds: i64,
    #[prost(int32, tag = "2")]
    pub(super) nanos: i32,
}

/// A vector.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Vector3 {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
}

/// An attitude.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Quaternion {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
    #[prost(double, tag = "3")]
    pub(super) z: f64,
    #[prost(double, tag = "4")]
    pub(super) w: f64,
}

/// Where something is, and how it is turned.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Pose {
    #[prost(message, optional, tag = "1")]
    pub(super) position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub(super) orientation: Option<Quaternion>,
}

/// A frame in another.
#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub(super) rotation: Option<Quaternion>,
}

/// All frames.
#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub(super) transforms: Vec<FrameTransform>,
}

/// A joint.
#[derive(Clone, PartialEq, Message)]
pub(super) struct JointState {
    #[prost(string, tag = "1")]
    pub(super) name: String,
    #[prost(double, optional, tag = "2")]
    pub(super) position: Option<f64>,
    #[prost(double, optional, tag = "3")]
    pub(super) velocity: Option<f64>,
    #[prost(double, optional, tag = "5")]
    pub(super) effort: Option<f64>,
}

/// All joints.
#[derive(Clone, PartialEq, Message)]
pub(super) struct JointStates {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(message, repeated, tag = "2")]
    pub(super) joints: Vec<JointState>,
}

/// Goals.
#[derive(Clone, PartialEq, Message)]
pub(super) struct PosesInFrame {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, repeated, tag = "3")]
    pub(super) poses: Vec<Pose>,
}

/// How far hands and base are from their goals, or in the other task from home.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Errors {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    /// Of each hand (m).
    #[prost(double, repeated, tag = "2")]
    pub(super) position_m: Vec<f64>,
    /// Of each hand, norm of the difference of Euler angles (rad).
    #[prost(double, repeated, tag = "3")]
    pub(super) orientation_rad: Vec<f64>,
    /// Of the base, likewise.
    #[prost(double, tag = "4")]
    pub(super) base_rad: f64,
}

/// A contact that pushes.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Contact {
    /// The body that is pushed.
    #[prost(string, tag = "1")]
    pub(super) on: String,
    /// The body that pushes.
    #[prost(string, tag = "2")]
    pub(super) by: String,
    /// Where, in the world (m).
    #[prost(message, optional, tag = "3")]
    pub(super) point: Option<Vector3>,
    /// World axes (N).
    #[prost(message, optional, tag = "4")]
    pub(super) force: Option<Vector3>,
}

/// What touches.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Contacts {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(message, repeated, tag = "2")]
    pub(super) contacts: Vec<Contact>,
}
