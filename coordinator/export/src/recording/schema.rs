//! Descriptions of the messages, by which a reader that does not know them takes them apart.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    OneofDescriptorProto,
};

/// What a field holds.
#[derive(Clone, Copy)]
enum Kind {
    I32,
    I64,
    F64,
    /// May be absent.
    OptionalF64,
    RepeatedF64,
    Text,
    One(&'static str),
    Many(&'static str),
}
use Kind::{F64, I32, I64, Many, One, OptionalF64, RepeatedF64, Text};

const TIMESTAMP: &str = "google.protobuf.Timestamp";
const VECTOR: &str = "foxglove.Vector3";
const QUATERNION: &str = "foxglove.Quaternion";

/// Fields of each message: name, number, kind. They follow Foxglove's schemas (MIT), whose names viewers know.
const MESSAGES: &[(&str, &[(&str, i32, Kind)])] = &[
    (TIMESTAMP, &[("seconds", 1, I64), ("nanos", 2, I32)]),
    (VECTOR, &[("x", 1, F64), ("y", 2, F64), ("z", 3, F64)]),
    (QUATERNION, &[("x", 1, F64), ("y", 2, F64), ("z", 3, F64), ("w", 4, F64)]),
    ("foxglove.Pose", &[("position", 1, One(VECTOR)), ("orientation", 2, One(QUATERNION))]),
    (
        "foxglove.FrameTransform",
        &[
            ("timestamp", 1, One(TIMESTAMP)),
            ("parent_frame_id", 2, Text),
            ("child_frame_id", 3, Text),
            ("translation", 4, One(VECTOR)),
            ("rotation", 5, One(QUATERNION)),
        ],
    ),
    ("foxglove.FrameTransforms", &[("transforms", 1, Many("foxglove.FrameTransform"))]),
    (
        "foxglove.JointState",
        &[
            ("name", 1, Text),
            ("position", 2, OptionalF64),
            ("velocity", 3, OptionalF64),
            ("acceleration", 4, OptionalF64),
            ("effort", 5, OptionalF64),
        ],
    ),
    (
        "foxglove.JointStates",
        &[("timestamp", 1, One(TIMESTAMP)), ("joints", 2, Many("foxglove.JointState"))],
    ),
    (
        "foxglove.PosesInFrame",
        &[
            ("timestamp", 1, One(TIMESTAMP)),
            ("frame_id", 2, Text),
            ("poses", 3, Many("foxglove.Pose")),
        ],
    ),
    (
        "spaceoctopus.Errors",
        &[
            ("timestamp", 1, One(TIMESTAMP)),
            ("position_m", 2, RepeatedF64),
            ("orientation_rad", 3, RepeatedF64),
            ("base_rad", 4, F64),
        ],
    ),
    (
        "spaceoctopus.Contact",
        &[("on", 1, Text), ("by", 2, Text), ("point", 3, One(VECTOR)), ("force", 4, One(VECTOR))],
    ),
    (
        "spaceoctopus.Contacts",
        &[("timestamp", 1, One(TIMESTAMP)), ("contacts", 2, Many("spaceoctopus.Contact"))],
    ),
];

/// The file that would declare a message.
fn file_name(message: &str) -> String {
    if message == TIMESTAMP {
        // Where everybody has it.
        return "google/protobuf/timestamp.proto".to_owned();
    }
    message.replace('.', "/") + ".proto"
}

/// Adds the file of a message behind those that it needs.
fn add(message: &str, files: &mut Vec<FileDescriptorProto>) {
    let name = file_name(message);
    if files.iter().any(|file| file.name.as_ref() == Some(&name)) {
        return;
    }
    let (_, fields) = MESSAGES.iter().find(|(known, _)| *known == message).expect("a message");
    let mut needed: Vec<&str> = Vec::new();
    for (_, _, kind) in *fields {
        if let One(other) | Many(other) = kind
            && !needed.contains(other)
        {
            needed.push(other);
            add(other, files);
        }
    }
    let (package, short) = message.rsplit_once('.').expect("a package");
    let mut described =
        DescriptorProto { name: Some(short.to_owned()), ..DescriptorProto::default() };
    for (field, number, kind) in *fields {
        let (label, r#type, type_name) = match kind {
            I32 => (Label::Optional, Type::Int32, None),
            I64 => (Label::Optional, Type::Int64, None),
            F64 | OptionalF64 => (Label::Optional, Type::Double, None),
            RepeatedF64 => (Label::Repeated, Type::Double, None),
            Text => (Label::Optional, Type::String, None),
            One(other) => (Label::Optional, Type::Message, Some(format!(".{other}"))),
            Many(other) => (Label::Repeated, Type::Message, Some(format!(".{other}"))),
        };
        let optional = matches!(kind, OptionalF64);
        // What may be absent stands in a choice of its own.
        let oneof_index = optional.then_some(described.oneof_decl.len() as i32);
        if optional {
            let name = Some(format!("_{field}"));
            described.oneof_decl.push(OneofDescriptorProto { name, options: None });
        }
        described.field.push(FieldDescriptorProto {
            name: Some((*field).to_owned()),
            number: Some(*number),
            label: Some(label as i32),
            r#type: Some(r#type as i32),
            type_name,
            oneof_index,
            proto3_optional: optional.then_some(true),
            ..FieldDescriptorProto::default()
        });
    }
    files.push(FileDescriptorProto {
        name: Some(name),
        package: Some(package.to_owned()),
        dependency: needed.into_iter().map(file_name).collect(),
        message_type: vec![described],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    });
}

/// The description of a message and of all that it is made of, as MCAP wants it.
pub(super) fn schema(message: &str) -> Vec<u8> {
    let mut files = Vec::new();
    add(message, &mut files);
    FileDescriptorSet { file: files }.encode_to_vec()
}
