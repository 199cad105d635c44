//! Parameters with their optimiser.

use tch::Tensor;

use crate::adam::Adam;
use crate::network::NetworkSpec;

/// The parameters of one kind of network and their optimiser.
#[derive(Debug)]
pub struct NetworkState {
    /// Names and places.
    pub spec: NetworkSpec,
    /// `[A, P]`: parameters.
    pub flat: Tensor,
    /// Moments.
    pub adam: Adam,
}
