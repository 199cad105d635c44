//! From a description to a robot: every value checked, with the file and the key in the message, and everything derived from them.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::description::{
    AngleContactDescription, CapsuleDescription, DiscDescription, LinkDescription,
    MountDescription, PedestalDescription, RobotDescription, ToolDescription,
};
use super::{
    AngleContact, Arm, ArmBody, ArmType, BaseBox, Joints, Link, MAX_ARMS, MAX_JOINTS_PER_ARM,
    MIN_JOINTS_PER_ARM, RigidBody, Robot, RobotError, Shape,
};

/// Largest number of a description: the simulator computes in single precision, which holds it.
const LARGEST: f64 = 1e36;
/// Farthest from the origin that the base may be at home, along each axis (m). A simulation takes ten times as much.
pub const FARTHEST_HOME: f64 = 100.0;
/// Largest joint angle at home (rad), a tenth of what a simulation takes.
const MOST_TURNED: f64 = 1000.0;

impl Robot {
    /// Validates and completes a description; `path` is only for messages.
    pub fn from_description(d: RobotDescription, path: &Path) -> Result<Self, RobotError> {
        let check = Check { path: path.display().to_string() };
        check.that(is_plain(&d.name), "name", &format!("{:?}", d.name), PLAIN)?;
        check.within("home_position", &d.home_position, FARTHEST_HOME)?;
        check.that(!d.base.is_empty(), "base", "no box", "at least one [[base]] box")?;
        check.that(
            (1..=MAX_ARMS).contains(&d.arms.len()),
            "arms",
            &format!("{} arms", d.arms.len()),
            &format!("1 to {MAX_ARMS} [[arms]]"),
        )?;

        // Keys hold names, so these come first.
        let box_names: Vec<&str> = d.base.iter().map(|b| b.name.as_str()).collect();
        check.names("base", &box_names, &[])?;
        let arm_names: Vec<&str> = d.arms.iter().map(|arm| arm.name.as_str()).collect();
        check.names("arms", &arm_names, &[])?;
        let mut boxes = Vec::new();
        for (i, b) in d.base.iter().enumerate() {
            let key = format!("base[{i}] ({})", b.name);
            check.sensible(&format!("{key}.position"), &b.position)?;
            check.sensible(&format!("{key}.euler_deg"), &b.euler_deg)?;
            let rotation = rotation_xyz_deg(b.euler_deg);
            boxes.push(solid_box(
                &check,
                &key,
                &b.name,
                b.size,
                b.mass,
                rotation,
                b.position.into(),
            )?);
        }
        // The type that arms have who name none, then the others by their names.
        let unnamed = ArmTypeParts {
            prefix: String::new(),
            mount: &d.mount,
            pedestal: &d.pedestal,
            links: &d.links,
            tool: &d.tool,
            angle_contacts: &d.angle_contacts,
        };
        let others = d.arm_types.iter().map(|(name, other)| ArmTypeParts {
            prefix: format!("arm_types.{name}."),
            mount: &other.mount,
            pedestal: &other.pedestal,
            links: &other.links,
            tool: &other.tool,
            angle_contacts: &other.angle_contacts,
        });
        let parts: Vec<ArmTypeParts> = std::iter::once(unnamed).chain(others).collect();
        let type_names: Vec<&str> = d.arm_types.keys().map(String::as_str).collect();
        for name in &type_names {
            check.that(is_plain(name), "a name in arm_types", &format!("{name:?}"), PLAIN)?;
        }
        let types =
            parts.iter().map(|part| resolve_type(&check, part)).collect::<Result<Vec<_>, _>>()?;
        let pedestals = parts
            .iter()
            .map(|part| resolve_pedestal(&check, part))
            .collect::<Result<Vec<_>, _>>()?;

        let mut arms = Vec::new();
        for (i, a) in d.arms.iter().enumerate() {
            let key = format!("arms[{i}] ({})", a.name);
            check.sensible(&format!("{key}.mount_position"), &a.mount_position)?;
            check.sensible(&format!("{key}.mount_euler_deg"), &a.mount_euler_deg)?;
            check.within(&format!("{key}.home"), &a.home, MOST_TURNED)?;
            let arm_type = match &a.arm_type {
                None => 0,
                Some(name) => {
                    let place = type_names.iter().position(|other| other == name);
                    1 + place.ok_or_else(|| {
                        let expected = match type_names.as_slice() {
                            [] => "no `type`, as the file has no `arm_types`".to_owned(),
                            names => format!("one of `arm_types`: {}", names.join(", ")),
                        };
                        check.error(&format!("{key}.type"), &format!("{name:?}"), &expected)
                    })?
                }
            };
            let (part, n_joints) = (&parts[arm_type], types[arm_type].links.len());
            let (pedestal, pedestal_shapes) = &pedestals[arm_type];
            check.that(
                a.home.len() == n_joints,
                &format!("{key}.home"),
                &format!("{} angles", a.home.len()),
                &format!("{n_joints} angles, one a joint"),
            )?;
            let mount_rotation = rotation_xyz_deg(a.mount_euler_deg);
            let position = Vector3::from(a.mount_position);
            let rotation = mount_rotation * rotation_xyz_deg(part.pedestal.euler_deg);
            let centre = position + mount_rotation * Vector3::from(part.mount.position);
            let name = format!("{}_mount", a.name);
            arms.push(Arm {
                mount: solid_box(
                    &check,
                    &format!("{}mount", part.prefix),
                    &name,
                    part.mount.size,
                    part.mount.mass,
                    mount_rotation,
                    centre,
                )?,
                pedestal: pedestal.moved(&rotation, &position),
                pedestal_shapes: pedestal_shapes
                    .iter()
                    .map(|s| s.moved(&rotation, &position))
                    .collect(),
                name: a.name.clone(),
                position,
                rotation,
                home: a.home.clone(),
                arm_type,
            });
        }
        check_whole_names(&check, &boxes, &arms, &types)?;
        let joints: Vec<usize> = arms.iter().map(|arm| arm.home.len()).collect();
        let welded = boxes.iter().map(|b| &b.body);
        let welded = welded.chain(arms.iter().flat_map(|a| [&a.mount.body, &a.pedestal]));
        let base = welded.cloned().reduce(|a, b| a.welded(&b)).expect("a base has a box");
        Ok(Self {
            name: d.name.clone(),
            n_arms: arms.len(),
            joints: Joints::new(&joints),
            base,
            boxes,
            types,
            arms,
            home_position: d.home_position,
            description: d,
        })
    }
}

/// The parts of one type of arms, and what stands before their keys in messages.
struct ArmTypeParts<'a> {
    prefix: String,
    mount: &'a MountDescription,
    pedestal: &'a PedestalDescription,
    links: &'a [LinkDescription],
    tool: &'a ToolDescription,
    angle_contacts: &'a [AngleContactDescription],
}

fn resolve_type(check: &Check, part: &ArmTypeParts<'_>) -> Result<ArmType, RobotError> {
    let prefix = &part.prefix;
    check.that(
        (MIN_JOINTS_PER_ARM..=MAX_JOINTS_PER_ARM).contains(&part.links.len()),
        &format!("{prefix}links"),
        &format!("{} rows", part.links.len()),
        &format!(
            "{MIN_JOINTS_PER_ARM} to {MAX_JOINTS_PER_ARM} [[{prefix}links]] rows, one a joint, each with dh, mass, com and inertia"
        ),
    )?;
    let names: Vec<&str> = part.links.iter().map(|link| link.name.as_str()).collect();
    check.names(&format!("{prefix}links"), &names, &["mount", "pedestal", "hand", "goal"])?;
    let links = part
        .links
        .iter()
        .enumerate()
        .map(|(i, link)| resolve_link(check, &format!("{prefix}links[{i}] ({})", link.name), link))
        .collect::<Result<Vec<_>, _>>()?;
    check.sensible(&format!("{prefix}tool.position"), &part.tool.position)?;
    let last = links.last().expect("an arm has links");
    let angle_contacts = part
        .angle_contacts
        .iter()
        .enumerate()
        .map(|(i, contact)| {
            resolve_angle_contact(check, &format!("{prefix}stops[{i}]"), contact, part.links)
        })
        .collect::<Result<Vec<_>, _>>()?;
    check_pushes(check, prefix, &angle_contacts)?;
    Ok(ArmType {
        tool_position: last.shift + last.twist * Vector3::from(part.tool.position),
        tool_rotation: last.twist,
        angle_contacts,
        links,
    })
}

/// Refuses names whose wholes are the same: outside of this file the parts of an arm bear its name, too.
fn check_whole_names(
    check: &Check,
    boxes: &[BaseBox],
    arms: &[Arm],
    types: &[ArmType],
) -> Result<(), RobotError> {
    let mut shapes: BTreeMap<String, String> = BTreeMap::new();
    let mut bodies = BTreeMap::new();
    shapes.extend(boxes.iter().map(|b| (b.name.clone(), format!("box `{}`", b.name))));
    for (i, arm) in arms.iter().enumerate() {
        let name = &arm.name;
        let new = |taken: &mut BTreeMap<String, String>, end: &str, what: &str| {
            let whole = format!("{name}_{end}");
            let what = format!("{what} of arm `{name}`");
            match taken.insert(whole.clone(), what.clone()) {
                None => Ok(()),
                Some(other) => Err(check.error(
                    &format!("arms[{i}].name"),
                    &format!("{name:?}"),
                    &format!(
                        "other names: {other} and {what} would both be `{whole}` in URDF, MJCF or recordings"
                    ),
                )),
            }
        };
        new(&mut shapes, "mount", "the mount")?;
        for place in 0..arm.pedestal_shapes.len() {
            new(&mut shapes, &format!("pedestal_{place}"), "a shape of the pedestal")?;
        }
        for link in &types[arm.arm_type].links {
            new(&mut bodies, &link.name, &format!("link `{}`", link.name))?;
            for place in 0..link.shapes.len() {
                let what = format!("a shape of link `{}`", link.name);
                new(&mut shapes, &format!("{}_{place}", link.name), &what)?;
            }
        }
        new(&mut bodies, "hand", "the hand")?;
        new(&mut bodies, "goal", "the goal")?;
    }
    Ok(())
}

/// The pedestal of a type, its inertial and its shapes in frame 0.
fn resolve_pedestal(
    check: &Check,
    part: &ArmTypeParts<'_>,
) -> Result<(RigidBody, Vec<Shape>), RobotError> {
    let (p, key) = (part.pedestal, format!("{}pedestal", part.prefix));
    let body = rigid_body(check, &key, p.mass, p.com, p.inertia)?;
    check.sensible(&format!("{key}.euler_deg"), &p.euler_deg)?;
    let shapes = shapes(check, &key, &p.capsules, &p.discs)?;
    let (mount, key) = (part.mount, format!("{}mount", part.prefix));
    check.sensible(&format!("{key}.position"), &mount.position)?;
    // Also of a type that no arm has.
    let (rotation, centre) = (Matrix3::identity(), Vector3::zeros());
    solid_box(check, &key, "mount", mount.size, mount.mass, rotation, centre)?;
    Ok((body, shapes))
}

/// What a name is made of: it goes into file names, messages and MJCF as it is.
const PLAIN: &str = "letters, digits, `-`, `_`";

fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.chars().all(plain)
}

/// Refuses values, naming file and key.
struct Check {
    path: String,
}

impl Check {
    fn error(&self, key: &str, found: &str, expected: &str) -> RobotError {
        RobotError::Value {
            path: self.path.clone(),
            key: key.to_owned(),
            found: found.to_owned(),
            expected: expected.to_owned(),
        }
    }

    fn that(&self, ok: bool, key: &str, found: &str, expected: &str) -> Result<(), RobotError> {
        if ok { Ok(()) } else { Err(self.error(key, found, expected)) }
    }

    fn sensible(&self, key: &str, values: &[f64]) -> Result<(), RobotError> {
        self.that(
            values.iter().all(|v| v.abs() <= LARGEST),
            key,
            &format!("{values:?}"),
            "numbers from -1e36 to 1e36",
        )
    }

    fn within(&self, key: &str, values: &[f64], limit: f64) -> Result<(), RobotError> {
        self.that(
            values.iter().all(|v| v.abs() <= limit),
            key,
            &format!("{values:?}"),
            &format!("numbers from -{limit} to {limit}"),
        )
    }

    fn positive(&self, key: &str, value: f64) -> Result<(), RobotError> {
        self.that(
            value > 0.0 && value <= LARGEST,
            key,
            &format!("{value}"),
            "a number above zero, 1e36 at most",
        )
    }

    /// Names by which files, messages and MJCF tell parts apart.
    fn names(&self, list: &str, names: &[&str], taken: &[&str]) -> Result<(), RobotError> {
        for (i, name) in names.iter().enumerate() {
            let free = !names[..i].contains(name) && !taken.contains(name);
            self.that(
                free && is_plain(name),
                &format!("{list}[{i}].name"),
                &format!("{name:?}"),
                &format!("{PLAIN}, other than {taken:?} and the names before it"),
            )?;
        }
        Ok(())
    }
}

fn resolve_link(check: &Check, key: &str, link: &LinkDescription) -> Result<Link, RobotError> {
    let dh = link.dh;
    check.sensible(&format!("{key}.dh"), &[dh.a, dh.d, dh.alpha_deg])?;
    let body = rigid_body(check, key, link.mass, link.com, link.inertia)?;
    check.that(
        (0.0..=LARGEST).contains(&link.armature),
        &format!("{key}.armature"),
        &link.armature.to_string(),
        "a number from zero to 1e36",
    )?;
    check.positive(&format!("{key}.servo.gain"), link.servo.gain)?;
    check.positive(&format!("{key}.servo.max_rate"), link.servo.max_rate)?;
    check.positive(&format!("{key}.servo.max_torque"), link.servo.max_torque)?;
    let (s, c) = sin_cos_deg(dh.alpha_deg);
    let twist = Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c);
    let shift = Vector3::new(dh.a, 0.0, dh.d);
    let local = shapes(check, key, &link.capsules, &link.discs)?;
    Ok(Link {
        name: link.name.clone(),
        shift,
        twist,
        body: body.moved(&twist, &shift),
        armature: link.armature,
        gain: link.servo.gain,
        max_rate: link.servo.max_rate,
        max_torque: link.servo.max_torque,
        shapes: local.iter().map(|s| s.moved(&twist, &shift)).collect(),
    })
}

fn resolve_angle_contact(
    check: &Check,
    key: &str,
    contact: &AngleContactDescription,
    links: &[LinkDescription],
) -> Result<AngleContact, RobotError> {
    let body = |name: &str| match name {
        "mount" => Some(ArmBody::Mount),
        "pedestal" => Some(ArmBody::Pedestal),
        _ => links.iter().position(|l| l.name == name).map(ArmBody::Link),
    };
    let named = |name: &str| {
        body(name).ok_or_else(|| {
            check.error(&format!("{key}.pair"), name, "`mount`, `pedestal` or the name of a link")
        })
    };
    let pair = [named(&contact.pair[0])?, named(&contact.pair[1])?];
    for (what, joint) in [("joint", contact.joint), ("narrowing_joint", contact.narrowing_joint)] {
        check.that(
            (1..=links.len()).contains(&joint),
            &format!("{key}.{what}"),
            &joint.to_string(),
            &format!("a joint from 1 to {}", links.len()),
        )?;
    }
    check.sensible(&format!("{key}.interval"), &contact.interval)?;
    let [lo, hi] = contact.interval;
    let half = (hi - lo) / 2.0;
    check.that(
        half > 0.0 && half < std::f64::consts::PI,
        &format!("{key}.interval"),
        &format!("{:?}", contact.interval),
        "lower end, then upper end, less than a turn apart",
    )?;
    check.that(
        (0.0..half).contains(&contact.narrowing),
        &format!("{key}.narrowing"),
        &contact.narrowing.to_string(),
        "at least zero and less than half of the interval",
    )?;
    check.that(
        !contact.push || links[contact.joint - 1].armature > 0.0,
        &format!("{key}.push"),
        "true at a joint whose link has no armature",
        "an armature above zero, which is the mass that the end of the interval pushes against",
    )?;
    Ok(AngleContact {
        pair,
        joint: contact.joint - 1,
        centre: f64::midpoint(lo, hi),
        half,
        narrowing: contact.narrowing,
        narrowing_joint: contact.narrowing_joint - 1,
        push: contact.push,
    })
}

/// Refuses a second stop of a joint that pushes: a goal posture knows one interval a joint.
fn check_pushes(check: &Check, prefix: &str, stops: &[AngleContact]) -> Result<(), RobotError> {
    for (i, stop) in stops.iter().enumerate().filter(|(_, stop)| stop.push) {
        let before = stops[..i].iter().position(|other| other.push && other.joint == stop.joint);
        if let Some(before) = before {
            let joint = stop.joint + 1;
            return Err(check.error(
                &format!("{prefix}stops[{i}].push"),
                &format!("true, as that of stops[{before}], for joint {joint}"),
                "one stop a joint that pushes: join the intervals, or let push of one be false",
            ));
        }
    }
    Ok(())
}

fn solid_box(
    check: &Check,
    key: &str,
    name: &str,
    size: [f64; 3],
    mass: f64,
    rotation: Matrix3<f64>,
    centre: Vector3<f64>,
) -> Result<BaseBox, RobotError> {
    for (axis, edge) in ["x", "y", "z"].iter().zip(size) {
        check.positive(&format!("{key}.size ({axis})"), edge)?;
    }
    check.positive(&format!("{key}.mass"), mass)?;
    let [x2, y2, z2] = size.map(|e| e * e);
    let inertia = Vector3::new(y2 + z2, x2 + z2, x2 + y2) * (mass / 12.0);
    let body = RigidBody { mass, com: Vector3::zeros(), inertia: Matrix3::from_diagonal(&inertia) };
    Ok(BaseBox {
        name: name.to_owned(),
        half: Vector3::from(size) / 2.0,
        centre,
        rotation,
        body: body.moved(&rotation, &centre),
    })
}

fn rigid_body(
    check: &Check,
    key: &str,
    mass: f64,
    com: [f64; 3],
    inertia: [f64; 6],
) -> Result<RigidBody, RobotError> {
    check.positive(&format!("{key}.mass"), mass)?;
    check.sensible(&format!("{key}.com"), &com)?;
    check.sensible(&format!("{key}.inertia"), &inertia)?;
    let [xx, yy, zz, xy, xz, yz] = inertia;
    let tensor = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let mut principal = SymmetricEigen::new(tensor).eigenvalues;
    principal.as_mut_slice().sort_by(f64::total_cmp);
    check.that(
        principal[0] > 0.0,
        &format!("{key}.inertia"),
        &format!("{inertia:?} with principal moments {:?}", principal.as_slice()),
        "a positive definite tensor (xx, yy, zz, xy, xz, yz)",
    )?;
    // No mass distribution has a principal moment above the sum of the two others. The slack is the rounding of decimal tables.
    check.that(
        principal[2] <= (principal[0] + principal[1]) * (1.0 + 1e-6),
        &format!("{key}.inertia"),
        &format!("{inertia:?} with principal moments {:?}", principal.as_slice()),
        "no principal moment above the sum of the two others (triangle inequality)",
    )?;
    Ok(RigidBody { mass, com: com.into(), inertia: tensor })
}

fn shapes(
    check: &Check,
    key: &str,
    capsules: &[CapsuleDescription],
    discs: &[DiscDescription],
) -> Result<Vec<Shape>, RobotError> {
    let mut out = Vec::new();
    for (i, c) in capsules.iter().enumerate() {
        check.sensible(&format!("{key}.capsules[{i}].from"), &c.from)?;
        check.sensible(&format!("{key}.capsules[{i}].to"), &c.to)?;
        check.positive(&format!("{key}.capsules[{i}].radius"), c.radius)?;
        out.push(Shape::Capsule { from: c.from.into(), to: c.to.into(), radius: c.radius });
    }
    for (i, d) in discs.iter().enumerate() {
        check.positive(&format!("{key}.discs[{i}].radius"), d.radius)?;
        check.sensible(&format!("{key}.discs[{i}].z"), &d.z)?;
        check.that(
            d.z[0] < d.z[1],
            &format!("{key}.discs[{i}].z"),
            &format!("{:?}", d.z),
            "the lower end, then the upper end",
        )?;
        out.push(Shape::Disc {
            centre: Vector3::new(0.0, 0.0, f64::midpoint(d.z[0], d.z[1])),
            axis: Vector3::z(),
            radius: d.radius,
            half_height: (d.z[1] - d.z[0]) / 2.0,
        });
    }
    Ok(out)
}

/// Rx(a) Ry(b) Rz(c), angles in degrees.
fn rotation_xyz_deg(angles: [f64; 3]) -> Matrix3<f64> {
    let [(sa, ca), (sb, cb), (sc, cc)] = angles.map(sin_cos_deg);
    let x = Matrix3::new(1.0, 0.0, 0.0, 0.0, ca, -sa, 0.0, sa, ca);
    let y = Matrix3::new(cb, 0.0, sb, 0.0, 1.0, 0.0, -sb, 0.0, cb);
    let z = Matrix3::new(cc, -sc, 0.0, sc, cc, 0.0, 0.0, 0.0, 1.0);
    // Adding zero turns −0 into 0, which keeps exported numbers tidy.
    (x * y * z).map(|v| v + 0.0)
}

/// Sine and cosine of an angle in degrees, exact at right angles.
fn sin_cos_deg(deg: f64) -> (f64, f64) {
    let turns = deg / 90.0;
    if turns == turns.round() && turns.abs() < 1e9 {
        [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][(turns as i64).rem_euclid(4) as usize]
    } else {
        // Not the C library's: the same bits everywhere.
        libm::sincos(deg.to_radians())
    }
}
