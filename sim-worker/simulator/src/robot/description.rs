//! The robot description as it stands in a TOML file: data, not code.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A robot as described in a file; [`Robot`](super::Robot) is its validated form.
///
/// Lengths in m, masses in kg, inertias in kg m², joint angles in rad; fixed rotations in degrees, so that right angles are exact.
/// Inertia tensors are given as their six elements xx, yy, zz, xy, xz, yz.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotDescription {
    /// Name for tables and files.
    pub name: String,
    /// Origin of the base frame in the world at the home pose; the attitude there is the identity.
    pub home_position: [f64; 3],
    /// Boxes that make up the base. The first is the one whose mass `with_base_mass` changes.
    pub base: Vec<BoxDescription>,
    /// The box between the base and each arm; its pose is in the mount frame. What follows is of all arms that name no type.
    pub mount: MountDescription,
    /// The fixed first link of each arm.
    pub pedestal: PedestalDescription,
    /// The moving links of each arm, 2 to 7, in the order of the chain.
    pub links: Vec<LinkDescription>,
    /// The hand.
    pub tool: ToolDescription,
    /// Pairs of one arm that touch by joint angle; the key in files is `stops`.
    #[serde(default, rename = "stops")]
    pub angle_contacts: Vec<AngleContactDescription>,
    /// Arms of other types, by the name that `type` of an arm gives.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub arm_types: BTreeMap<String, ArmTypeDescription>,
    /// The arms: where they stand and how they are folded at home.
    pub arms: Vec<ArmDescription>,
}

impl RobotDescription {
    /// The links of each type of arms: the type at the top of the file, then the others.
    pub fn links_of_types_mut(&mut self) -> impl Iterator<Item = &mut Vec<LinkDescription>> {
        let others = self.arm_types.values_mut().map(|other| &mut other.links);
        std::iter::once(&mut self.links).chain(others)
    }
}

/// What arms of another type are made of; keys as at the top of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmTypeDescription {
    /// The box between the base and each arm.
    pub mount: MountDescription,
    /// The fixed first link of each arm.
    pub pedestal: PedestalDescription,
    /// The moving links of each arm, 2 to 7, in the order of the chain.
    pub links: Vec<LinkDescription>,
    /// The hand.
    pub tool: ToolDescription,
    /// Pairs of one arm that touch by joint angle; the key in files is `stops`.
    #[serde(default, rename = "stops")]
    pub angle_contacts: Vec<AngleContactDescription>,
}

/// A solid box of the base.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoxDescription {
    /// Name in messages.
    pub name: String,
    /// Edge lengths.
    pub size: [f64; 3],
    /// Mass, spread evenly.
    pub mass: f64,
    /// Centre in the base frame.
    #[serde(default)]
    pub position: [f64; 3],
    /// Rotation to the base frame, intrinsic x-y-z.
    #[serde(default)]
    pub euler_deg: [f64; 3],
}

/// The box between the base and an arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountDescription {
    /// Edge lengths.
    pub size: [f64; 3],
    /// Mass, spread evenly.
    pub mass: f64,
    /// Centre in the mount frame.
    pub position: [f64; 3],
}

/// The fixed first link of an arm; its frame is the frame 0 of the chain, at the origin of the mount frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PedestalDescription {
    /// Rotation of frame 0 to the mount frame, intrinsic x-y-z.
    #[serde(default)]
    pub euler_deg: [f64; 3],
    /// Mass.
    pub mass: f64,
    /// Centre of mass in frame 0.
    pub com: [f64; 3],
    /// Inertia about the centre of mass, axes of frame 0.
    pub inertia: [f64; 6],
    /// Shapes in frame 0.
    #[serde(default)]
    pub capsules: Vec<CapsuleDescription>,
    /// Shapes in frame 0.
    #[serde(default)]
    pub discs: Vec<DiscDescription>,
}

/// One row of standard Denavit–Hartenberg parameters; the angle is the joint's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DhRow {
    /// Length of the common normal.
    pub a: f64,
    /// Offset along the joint's axis.
    pub d: f64,
    /// Twist.
    pub alpha_deg: f64,
}

/// The velocity servo of a joint: τ = clamp(gain · (clamp(c, ±max_rate) − q̇), ±max_torque).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoDescription {
    /// Torque per rate error (N m s/rad).
    pub gain: f64,
    /// Largest commanded rate (rad/s).
    pub max_rate: f64,
    /// Largest torque (N m).
    pub max_torque: f64,
}

/// A moving link with the joint that carries it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkDescription {
    /// Name in messages, pairs and exported models.
    pub name: String,
    /// From the frame before to this link's frame.
    pub dh: DhRow,
    /// Mass.
    pub mass: f64,
    /// Centre of mass in this link's frame.
    pub com: [f64; 3],
    /// Inertia about the centre of mass, axes of this link's frame.
    pub inertia: [f64; 6],
    /// Inertia of the drive, added to the joint's own (kg m²).
    #[serde(default)]
    pub armature: f64,
    /// The joint's servo.
    pub servo: ServoDescription,
    /// Shapes in this link's frame.
    #[serde(default)]
    pub capsules: Vec<CapsuleDescription>,
    /// Shapes in this link's frame.
    #[serde(default)]
    pub discs: Vec<DiscDescription>,
}

/// All points within `radius` of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CapsuleDescription {
    /// One end of the segment.
    pub from: [f64; 3],
    /// The other end.
    pub to: [f64; 3],
    /// Radius.
    pub radius: f64,
}

/// A cylinder about the z axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscDescription {
    /// Radius.
    pub radius: f64,
    /// Lower and upper end along z.
    pub z: [f64; 2],
}

/// The frame of the hand, fixed to the last link without rotation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolDescription {
    /// Origin in the last link's frame.
    pub position: [f64; 3],
}

/// A pair of one arm that touches exactly when a joint stands in an interval.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AngleContactDescription {
    /// The two bodies: links' names, or `mount`, `pedestal`.
    pub pair: [String; 2],
    /// The joint, counted from 1.
    pub joint: usize,
    /// Interval of the joint's angle modulo a turn (rad).
    pub interval: [f64; 2],
    /// The interval is shorter at both ends by this times |sin 2q| (rad).
    #[serde(default)]
    pub narrowing: f64,
    /// The joint q of the narrowing, counted from 1.
    #[serde(default = "first_joint")]
    pub narrowing_joint: usize,
    /// Whether the ends of the interval push back.
    pub push: bool,
}

fn first_joint() -> usize {
    1
}

/// One arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmDescription {
    /// Name in messages and exported models.
    pub name: String,
    /// Its type, one of `arm_types`; without, the type that the file describes at its top.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub arm_type: Option<String>,
    /// Origin of the mount frame in the base frame.
    pub mount_position: [f64; 3],
    /// Rotation of the mount frame to the base frame, intrinsic x-y-z.
    #[serde(default)]
    pub mount_euler_deg: [f64; 3],
    /// Joint angles at home (rad), one a link.
    pub home: Vec<f64>,
}
