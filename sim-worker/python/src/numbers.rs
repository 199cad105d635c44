//! Arrays of Python's in and out.

use numpy::{PyArrayDyn, PyArrayMethods as _, PyUntypedArray, PyUntypedArrayMethods as _};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyOverflowError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::IntoPyDict as _;

use simulator::robot::Joints;

use crate::errors::value;

/// A whole number. One that its type cannot hold is refused as others out of range are, and not as Python does, by an `OverflowError`.
///
/// # Errors
/// `TypeError` for what is no whole number, `ValueError` for one out of range.
pub(crate) fn whole<'py, T: FromPyObjectOwned<'py>>(given: &Bound<'py, PyAny>) -> PyResult<T> {
    given.extract::<T>().map_err(|error| {
        let error: PyErr = error.into();
        if !error.is_instance_of::<PyOverflowError>(given.py()) {
            return error;
        }
        let most = u64::MAX >> (64 - 8 * size_of::<T>());
        value(format!("{given} is out of range, expected 0 to {most}"))
    })
}

/// Likewise, where none may be given.
pub(crate) fn whole_or_none<'py, T: FromPyObjectOwned<'py>>(
    given: &Bound<'py, PyAny>,
) -> PyResult<Option<T>> {
    if given.is_none() { Ok(None) } else { whole(given).map(Some) }
}

/// `given` as contiguous single precision of this shape: itself where it is that already.
///
/// # Errors
/// `TypeError` if it holds no real numbers, `ValueError` if it has another shape.
pub(crate) fn single<'py>(
    given: &Bound<'py, PyAny>,
    what: &str,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let array = single_of_any_shape(given, what)?;
    has_shape(&array, what, shape)?;
    Ok(array)
}

/// `given` as contiguous single precision of any shape.
pub(crate) fn single_of_any_shape<'py>(
    given: &Bound<'py, PyAny>,
    what: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    Ok(real(given, what, "float32")?.cast_into::<PyArrayDyn<f32>>()?)
}

/// Refuses an array of another shape.
///
/// # Errors
/// `ValueError` if it has one.
pub(crate) fn has_shape<T: numpy::Element>(
    array: &Bound<'_, PyArrayDyn<T>>,
    what: &str,
    shape: &[usize],
) -> PyResult<()> {
    if array.shape() == shape {
        return Ok(());
    }
    let found = words(array.shape());
    Err(value(format!("{what} has shape {found}, expected {}", words(shape))))
}

/// `given` as contiguous double precision of any shape.
pub(crate) fn double<'py>(
    given: &Bound<'py, PyAny>,
    what: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    Ok(real(given, what, "float64")?.cast_into::<PyArrayDyn<f64>>()?)
}

fn real<'py>(given: &Bound<'py, PyAny>, what: &str, dtype: &str) -> PyResult<Bound<'py, PyAny>> {
    let numpy = given.py().import("numpy")?;
    let array = match given.cast::<PyUntypedArray>() {
        Ok(array) => array.clone().into_any(),
        Err(_) => numpy.call_method1("asarray", (given,))?,
    };
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        let found = array.getattr("dtype")?.str()?;
        return Err(PyTypeError::new_err(format!(
            "{what} is of type {found}, expected real numbers ({dtype})"
        )));
    }
    let keywords = [("dtype", dtype)].into_py_dict(given.py())?;
    // Larger numbers than single precision has become infinite, and are refused as such; smaller ones become zero. Whatever a program wants to hear of its own
    // numbers, it need not hear that.
    let quiet = [("all", "ignore")].into_py_dict(given.py())?;
    let quiet = numpy.call_method("errstate", (), Some(&quiet))?;
    quiet.call_method0("__enter__")?;
    let converted = numpy.call_method("ascontiguousarray", (array,), Some(&keywords));
    quiet.call_method1("__exit__", (given.py().None(), given.py().None(), given.py().None()))?;
    let converted = converted?;
    // It makes a number an array of one.
    Ok(converted)
}

fn words(shape: &[usize]) -> String {
    let sizes: Vec<String> = shape.iter().map(usize::to_string).collect();
    match sizes.as_slice() {
        [one] => format!("({one},)"),
        sizes => format!("({})", sizes.join(", ")),
    }
}

/// What belongs to joints, `[n, joints]`, by arm: `[n, arms, J]` with room for the longest arm, zeros behind the joints of a shorter one.
pub(crate) fn by_arm<T: Copy + Default>(joints: &Joints, numbers: &[T]) -> Vec<T> {
    let room = joints.longest_arm();
    let of_row = |row: &[T]| {
        let arms = (0..joints.n_arms()).flat_map(|arm| {
            let own = &row[joints.of_arm(arm)];
            own.iter().copied().chain(std::iter::repeat_n(T::default(), room - own.len()))
        });
        arms.collect::<Vec<T>>()
    };
    numbers.chunks_exact(joints.n_joints()).flat_map(of_row).collect()
}

/// What belongs to joints, `[joints]`, by agent: `[A, U]`, zeros where an agent has no joint.
pub(crate) fn by_agent<T: Copy + Default>(joints: &Joints, numbers: &[T]) -> Vec<T> {
    let room = joints.per_agent();
    let of_agent = |agent| {
        let own = &numbers[joints.of_agent(agent)];
        own.iter().copied().chain(std::iter::repeat_n(T::default(), room - own.len()))
    };
    (0..joints.n_agents()).flat_map(of_agent).collect()
}

/// Zeros of NumPy's own, so that too many of them are a `MemoryError`.
pub(crate) fn zeros<'py>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let array = py.import("numpy")?.call_method1("zeros", (shape.to_vec(), "float32"))?;
    Ok(array.cast_into::<PyArrayDyn<f32>>()?)
}

/// Numbers as an array of this shape.
pub(crate) fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    numbers: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    numpy::PyArray1::from_vec(py, numbers).reshape(shape.to_vec())
}
