//! The links and joints of a URDF, every number checked.
//!
//! Lengths in m, masses in kg, angles in rad, as URDF has them.

use std::collections::BTreeSet;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document as Xml, Node, ParsingOptions};

use crate::error::UrdfError;

/// More elements than any robot has.
const MOST_NODES: u32 = 100_000;
/// Kinds of what is passed over that are told.
const MOST_IGNORED: usize = 20;
/// More metres, kilograms or newtons than any robot has.
const LARGEST: f64 = 1e9;

/// A robot as it is written down.
#[derive(Debug, Clone)]
pub(crate) struct Document {
    pub(crate) name: String,
    pub(crate) links: Vec<Link>,
    pub(crate) joints: Vec<Joint>,
    /// What is passed over, each kind once.
    pub(crate) ignored: BTreeSet<String>,
}

#[derive(Debug, Clone)]
pub(crate) struct Link {
    pub(crate) name: String,
    pub(crate) inertial: Option<Inertial>,
    pub(crate) collisions: Vec<Collision>,
}

/// A mass about its centre: `origin` is there, and the inertia is in its axes.
#[derive(Debug, Clone)]
pub(crate) struct Inertial {
    pub(crate) origin: Isometry3<f64>,
    pub(crate) mass: f64,
    pub(crate) inertia: Matrix3<f64>,
}

#[derive(Debug, Clone)]
pub(crate) struct Collision {
    pub(crate) origin: Isometry3<f64>,
    pub(crate) geometry: Geometry,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Geometry {
    Box {
        size: [f64; 3],
    },
    /// About its z axis.
    Cylinder {
        radius: f64,
        length: f64,
    },
    Sphere {
        radius: f64,
    },
    /// In a file of its own, which is not read.
    Mesh,
}

#[derive(Debug, Clone)]
pub(crate) struct Joint {
    pub(crate) name: String,
    pub(crate) moves: bool,
    /// From the parent link's frame to the joint's.
    pub(crate) origin: Isometry3<f64>,
    pub(crate) parent: String,
    pub(crate) child: String,
    /// In the joint's frame.
    pub(crate) axis: Unit<Vector3<f64>>,
    /// N m.
    pub(crate) effort: Option<f64>,
    /// rad/s.
    pub(crate) velocity: Option<f64>,
}

impl Document {
    pub(crate) fn parse(text: &str) -> Result<Self, UrdfError> {
        let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
        let xml = Xml::parse_with_options(text, options)
            .map_err(|error| UrdfError::Xml(error.to_string()))?;
        let root = xml.root_element();
        if root.tag_name().name() != "robot" {
            return Err(wrong(root, "the outermost element", "<robot name=\"…\">"));
        }
        let mut document = Self {
            name: root.attribute("name").unwrap_or("robot").to_owned(),
            links: Vec::new(),
            joints: Vec::new(),
            ignored: BTreeSet::new(),
        };
        for node in elements(root) {
            match node.tag_name().name() {
                "link" => {
                    let link = document.link(node)?;
                    document.links.push(link);
                }
                "joint" => {
                    let joint = document.joint(node)?;
                    document.joints.push(joint);
                }
                "material" => {}
                other => document.ignore(&format!("<{other}>")),
            }
        }
        Ok(document)
    }

    /// Remembers what is passed over; of a file that has nothing else not all of it.
    fn ignore(&mut self, what: &str) {
        if self.ignored.len() < MOST_IGNORED {
            self.ignored.insert(what.chars().take(60).collect());
        }
    }

    fn link(&mut self, node: Node<'_, '_>) -> Result<Link, UrdfError> {
        let name = attribute(node, "name")?.to_owned();
        let (mut inertial, mut collisions) = (None, Vec::new());
        for part in elements(node) {
            match part.tag_name().name() {
                "inertial" => inertial = Some(read_inertial(part)?),
                "collision" => collisions.push(Collision {
                    origin: origin(part)?,
                    geometry: geometry(child(part, "geometry")?)?,
                }),
                // Seen, not touched.
                "visual" => {}
                other => self.ignore(&format!("<{other}> of links")),
            }
        }
        Ok(Link { name, inertial, collisions })
    }

    fn joint(&mut self, node: Node<'_, '_>) -> Result<Joint, UrdfError> {
        let name = attribute(node, "name")?.to_owned();
        let kind = attribute(node, "type")?;
        let moves = match kind {
            "fixed" => false,
            "revolute" | "continuous" => true,
            "floating" => {
                let cure = "no joint: leave out the world, the base floats by itself";
                return Err(wrong(node, "type=\"floating\"", cure));
            }
            _ => {
                return Err(wrong(
                    node,
                    format!("type=\"{kind}\""),
                    "`revolute`, `continuous` or `fixed`: joints that slide cannot be trained",
                ));
            }
        };
        let axis = match optional_child(node, "axis").filter(|_| moves) {
            Some(axis) => {
                let [x, y, z] = three(axis, "xyz")?;
                Unit::try_new(Vector3::new(x, y, z), 1e-6)
                    .ok_or_else(|| wrong(axis, "an axis of no length", "a direction"))?
            }
            None => Vector3::x_axis(),
        };
        let limit = optional_child(node, "limit").filter(|_| moves);
        // Zero is what some programs write where nobody has said anything.
        let of_limit = |key: &str| match limit {
            Some(limit) if limit.has_attribute(key) => {
                let value = number(limit, key)?;
                if value < 0.0 {
                    return Err(wrong(limit, format!("{key}=\"{value}\""), "a number above zero"));
                }
                Ok((value > 0.0).then_some(value))
            }
            _ => Ok(None),
        };
        let (effort, velocity) = (of_limit("effort")?, of_limit("velocity")?);
        if let Some(limit) = limit
            && (limit.has_attribute("lower") || limit.has_attribute("upper"))
            && kind == "revolute"
        {
            self.ignore("position limits (`lower`, `upper`): joints turn without end");
        }
        for part in elements(node) {
            match part.tag_name().name() {
                "origin" | "parent" | "child" | "axis" | "limit" => {}
                "mimic" => {
                    return Err(wrong(part, "a joint that follows another", "joints of their own"));
                }
                other => self.ignore(&format!("<{other}> of joints")),
            }
        }
        Ok(Joint {
            moves,
            origin: origin(node)?,
            parent: attribute(child(node, "parent")?, "link")?.to_owned(),
            child: attribute(child(node, "child")?, "link")?.to_owned(),
            axis,
            effort,
            velocity,
            name,
        })
    }
}

fn read_inertial(node: Node<'_, '_>) -> Result<Inertial, UrdfError> {
    let tensor = child(node, "inertia")?;
    let moment = |key: &str| number(tensor, key);
    // Products of inertia are zero unless they are said.
    let product = |key: &str| if tensor.has_attribute(key) { number(tensor, key) } else { Ok(0.0) };
    let (xx, yy, zz) = (moment("ixx")?, moment("iyy")?, moment("izz")?);
    let (xy, xz, yz) = (product("ixy")?, product("ixz")?, product("iyz")?);
    let mass = child(node, "mass")?;
    let value = number(mass, "value")?;
    if value < 0.0 {
        return Err(wrong(mass, format!("value=\"{value}\""), "a mass, zero or above"));
    }
    Ok(Inertial {
        origin: origin(node)?,
        mass: value,
        inertia: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
    })
}

fn geometry(node: Node<'_, '_>) -> Result<Geometry, UrdfError> {
    let shape = elements(node).next();
    let shape = shape.ok_or_else(|| wrong(node, "no shape", "a box, cylinder, sphere or mesh"))?;
    Ok(match shape.tag_name().name() {
        "box" => {
            let size = three(shape, "size")?;
            if size.iter().any(|&edge| edge <= 0.0) {
                return Err(wrong(shape, format!("size {size:?}"), "edges above zero"));
            }
            Geometry::Box { size }
        }
        "cylinder" => Geometry::Cylinder {
            radius: positive(shape, "radius")?,
            length: positive(shape, "length")?,
        },
        "sphere" => Geometry::Sphere { radius: positive(shape, "radius")? },
        "mesh" => Geometry::Mesh,
        other => return Err(wrong(shape, format!("<{other}>"), "a box, cylinder, sphere or mesh")),
    })
}

/// The pose in the `<origin>` of an element; none is the identity. Angles are those of Rz(yaw) Ry(pitch) Rx(roll).
fn origin(node: Node<'_, '_>) -> Result<Isometry3<f64>, UrdfError> {
    let Some(origin) = optional_child(node, "origin") else { return Ok(Isometry3::identity()) };
    let of = |key: &str| if origin.has_attribute(key) { three(origin, key) } else { Ok([0.0; 3]) };
    let ([x, y, z], [roll, pitch, yaw]) = (of("xyz")?, of("rpy")?);
    let rotation = Rotation3::from_euler_angles(roll, pitch, yaw);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn elements<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(Node::is_element)
}

fn optional_child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    elements(node).find(|child| child.tag_name().name() == name)
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Result<Node<'a, 'i>, UrdfError> {
    optional_child(node, name)
        .ok_or_else(|| wrong(node, format!("no <{name}>"), format!("a <{name}>")))
}

fn attribute<'a>(node: Node<'a, '_>, key: &str) -> Result<&'a str, UrdfError> {
    node.attribute(key)
        .ok_or_else(|| wrong(node, format!("no `{key}`"), format!("an attribute `{key}`")))
}

fn parsed(node: Node<'_, '_>, key: &str, word: &str) -> Result<f64, UrdfError> {
    let value = word.parse::<f64>().ok().filter(|value| value.abs() < LARGEST);
    value.ok_or_else(|| wrong(node, format!("{key}={word:?}"), "a number between -1e9 and 1e9"))
}

fn number(node: Node<'_, '_>, key: &str) -> Result<f64, UrdfError> {
    parsed(node, key, attribute(node, key)?.trim())
}

fn positive(node: Node<'_, '_>, key: &str) -> Result<f64, UrdfError> {
    let value = number(node, key)?;
    if value > 0.0 {
        return Ok(value);
    }
    Err(wrong(node, format!("{key}=\"{value}\""), "a number above zero"))
}

fn three(node: Node<'_, '_>, key: &str) -> Result<[f64; 3], UrdfError> {
    let text = attribute(node, key)?;
    let words: Vec<&str> = text.split_whitespace().collect();
    let [x, y, z] = words[..] else {
        return Err(wrong(node, format!("{key}={text:?}"), "three numbers"));
    };
    Ok([parsed(node, key, x)?, parsed(node, key, y)?, parsed(node, key, z)?])
}

/// Names an element by the nearest one around it that has a name.
fn wrong(node: Node<'_, '_>, found: impl Into<String>, expected: impl Into<String>) -> UrdfError {
    let line = node.document().text_pos_at(node.range().start).row;
    let tag = node.tag_name().name();
    let named = node.ancestors().find(|around| around.has_attribute("name"));
    let element = match named {
        Some(around) if around == node => {
            format!("<{tag} name={:?}>", around.attribute("name").unwrap_or_default())
        }
        Some(around) => format!(
            "<{tag}> of {} {:?}",
            around.tag_name().name(),
            around.attribute("name").unwrap_or_default()
        ),
        None => format!("<{tag}>"),
    };
    UrdfError::Element { line, element, found: found.into(), expected: expected.into() }
}
