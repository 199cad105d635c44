//! Puts a graph of operators together.

use prost::Message as _;

use super::proto::{
    AttributeProto, BFLOAT16, Dimension, DimensionValue, FLOAT, GraphProto, INT64, ModelProto,
    NodeProto, OperatorSetIdProto, StringStringEntryProto, TensorProto, TensorShapeProto,
    TensorType, TypeProto, ValueInfoProto,
};
use crate::networks::Stacked;

/// Version of ONNX's file format, and of its operators: old enough for runtimes in the field.
const IR_VERSION: i64 = 8;
const OPSET: i64 = 18;

/// Name of a tensor in the graph.
pub(super) type Value = String;

/// A setting of an operator.
pub(super) enum Attribute {
    Float(&'static str, f32),
    Int(&'static str, i64),
    Ints(&'static str, Vec<i64>),
}

/// A graph on its way.
#[derive(Default)]
pub(super) struct Graph {
    graph: GraphProto,
}

fn value_info(name: &str, shape: &[usize], doc: &str) -> ValueInfoProto {
    let batch = Dimension { value: Some(DimensionValue::Param("batch".to_owned())) };
    let fixed = shape.iter().map(|&n| Dimension { value: Some(DimensionValue::Value(n as i64)) });
    let shape = TensorShapeProto { dim: std::iter::once(batch).chain(fixed).collect() };
    let tensor_type = Some(TensorType { elem_type: Some(FLOAT), shape: Some(shape) });
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto { tensor_type }),
        doc_string: Some(doc.to_owned()),
    }
}

impl Graph {
    /// An input `[batch, …shape]`.
    pub(super) fn input(&mut self, name: &str, shape: &[usize], doc: &str) -> Value {
        self.graph.input.push(value_info(name, shape, doc));
        name.to_owned()
    }

    /// Makes `value` the output `name`, `[batch, …shape]`.
    pub(super) fn output(&mut self, name: &str, value: &Value, shape: &[usize], doc: &str) {
        self.add("Identity", &[value], Vec::new(), name);
        self.graph.output.push(value_info(name, shape, doc));
    }

    fn add(&mut self, op: &str, inputs: &[&Value], attributes: Vec<Attribute>, output: &str) {
        let attribute = attributes.into_iter().map(|attribute| {
            let empty = AttributeProto::default();
            match attribute {
                Attribute::Float(name, f) => AttributeProto {
                    name: Some(name.to_owned()),
                    f: Some(f),
                    r#type: Some(1),
                    ..empty
                },
                Attribute::Int(name, i) => AttributeProto {
                    name: Some(name.to_owned()),
                    i: Some(i),
                    r#type: Some(2),
                    ..empty
                },
                Attribute::Ints(name, ints) => {
                    AttributeProto { name: Some(name.to_owned()), ints, r#type: Some(7), ..empty }
                }
            }
        });
        self.graph.node.push(NodeProto {
            input: inputs.iter().map(|&input| input.clone()).collect(),
            output: vec![output.to_owned()],
            name: Some(format!("{op}_{}", self.graph.node.len())),
            op_type: Some(op.to_owned()),
            attribute: attribute.collect(),
        });
    }

    /// Applies an operator with settings.
    pub(super) fn with(
        &mut self,
        op: &str,
        inputs: &[&Value],
        attributes: Vec<Attribute>,
    ) -> Value {
        let output = format!("v{}", self.graph.node.len());
        self.add(op, inputs, attributes, &output);
        output
    }

    /// Applies an operator.
    pub(super) fn op(&mut self, op: &str, inputs: &[&Value]) -> Value {
        self.with(op, inputs, Vec::new())
    }

    fn tensor(
        &mut self,
        name: Option<&str>,
        dims: &[usize],
        data_type: i32,
        raw: Vec<u8>,
    ) -> Value {
        let dims: Vec<i64> = dims.iter().map(|&n| n as i64).collect();
        let same = |known: &&TensorProto| {
            known.dims == dims
                && known.data_type == Some(data_type)
                && known.raw_data.as_ref() == Some(&raw)
        };
        if let Some(known) = self.graph.initializer.iter().find(same) {
            return known.name.clone().unwrap_or_default();
        }
        let name = name.map_or_else(|| format!("c{}", self.graph.initializer.len()), str::to_owned);
        self.graph.initializer.push(TensorProto {
            dims,
            data_type: Some(data_type),
            name: Some(name.clone()),
            raw_data: Some(raw),
        });
        name
    }

    /// Constant numbers in single precision.
    pub(super) fn floats(&mut self, dims: &[usize], values: &[f64]) -> Value {
        assert_eq!(dims.iter().product::<usize>(), values.len(), "a full tensor");
        let raw = values.iter().flat_map(|&x| (x as f32).to_le_bytes()).collect();
        self.tensor(None, dims, FLOAT, raw)
    }

    /// One constant number.
    pub(super) fn float(&mut self, value: f64) -> Value {
        self.floats(&[], &[value])
    }

    /// Constant whole numbers.
    pub(super) fn ints(&mut self, values: &[i64]) -> Value {
        let raw = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.tensor(None, &[values.len()], INT64, raw)
    }

    /// A tensor of all actors, `[P, …shape]`: rows that several share are stored once.
    pub(super) fn stacked(&mut self, tensor: &Stacked, shape: &[usize]) -> Value {
        let dims = [&[tensor.rows.len()], shape].concat();
        let all = tensor.rows.iter().flatten();
        let stored = if tensor.half {
            let raw = all.flat_map(|x| ((x.to_bits() >> 16) as u16).to_le_bytes()).collect();
            let half = self.tensor(Some(&tensor.name), &dims, BFLOAT16, raw);
            self.cast(&half, FLOAT)
        } else {
            let raw = all.flat_map(|x| x.to_le_bytes()).collect();
            self.tensor(Some(&tensor.name), &dims, FLOAT, raw)
        };
        if tensor.row_of.iter().copied().eq(0..tensor.rows.len()) {
            return stored;
        }
        let rows: Vec<i64> = tensor.row_of.iter().map(|&row| row as i64).collect();
        let rows = self.ints(&rows);
        self.with("Gather", &[&stored, &rows], vec![Attribute::Int("axis", 0)])
    }

    /// `values` where the mask, of shape `dims`, is set, else zero: chosen, not multiplied, so that what is not taken may be anything.
    pub(super) fn or_zero(&mut self, dims: &[usize], mask: &[bool], values: &Value) -> Value {
        let mask: Vec<f64> = mask.iter().map(|&is| f64::from(u8::from(is))).collect();
        let (mask, zero) = (self.floats(dims, &mask), self.float(0.0));
        let mask = self.op("Greater", &[&mask, &zero]);
        self.op("Where", &[&mask, values, &zero])
    }

    /// Another type of number.
    pub(super) fn cast(&mut self, value: &Value, to: i32) -> Value {
        self.with("Cast", &[value], vec![Attribute::Int("to", to.into())])
    }

    /// Another shape; 0 keeps a dimension, −1 takes what is left.
    pub(super) fn reshape(&mut self, value: &Value, shape: &[i64]) -> Value {
        let shape = self.ints(shape);
        self.op("Reshape", &[value, &shape])
    }

    /// Axes in another order.
    pub(super) fn transpose(&mut self, value: &Value, order: &[i64]) -> Value {
        self.with("Transpose", &[value], vec![Attribute::Ints("perm", order.to_vec())])
    }

    /// Entries `indices` along `axis`.
    pub(super) fn gather(&mut self, value: &Value, axis: i64, indices: &[i64]) -> Value {
        let indices = self.ints(indices);
        self.with("Gather", &[value, &indices], vec![Attribute::Int("axis", axis)])
    }

    /// Side by side along the last axis.
    pub(super) fn concat(&mut self, values: &[Value]) -> Value {
        let values: Vec<&Value> = values.iter().collect();
        self.with("Concat", &values, vec![Attribute::Int("axis", -1)])
    }

    /// The bytes of a model file.
    pub(super) fn model(
        mut self,
        name: &str,
        doc: &str,
        metadata: &[(String, String)],
        version: &str,
    ) -> Vec<u8> {
        self.graph.name = Some(name.to_owned());
        let entry = |(key, value): &(String, String)| StringStringEntryProto {
            key: Some(key.clone()),
            value: Some(value.clone()),
        };
        let model = ModelProto {
            ir_version: Some(IR_VERSION),
            producer_name: Some("SpaceOctopus".to_owned()),
            producer_version: Some(version.to_owned()),
            doc_string: Some(doc.to_owned()),
            graph: Some(self.graph),
            opset_import: vec![OperatorSetIdProto {
                domain: Some(String::new()),
                version: Some(OPSET),
            }],
            metadata_props: metadata.iter().map(entry).collect(),
        };
        model.encode_to_vec()
    }
}
