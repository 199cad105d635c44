//! The 128-bit fingerprint of a training state or of a block.

use std::fmt;

/// BLAKE3 truncated to 128 bits, written as 32 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Digest(pub [u8; 16]);

impl Digest {
    /// Of a block: of its numbers as they lie in memory.
    pub fn of_block(numbers: &[f32]) -> Self {
        Self::short(&blake3::hash(bytemuck::cast_slice(numbers)))
    }

    fn short(hash: &blake3::Hash) -> Self {
        let mut short = [0; 16];
        short.copy_from_slice(&hash.as_bytes()[..16]);
        Self(short)
    }
}

/// Hashes named tensors and counters into a [`Digest`].
#[derive(Debug, Default)]
pub struct DigestBuilder(blake3::Hasher);

impl DigestBuilder {
    /// An empty hash.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a named field; name and length are part of the hash, so no two states collide by
    /// moving a byte from one field to the next.
    pub fn field(&mut self, name: &str, bytes: &[u8]) -> &mut Self {
        self.begin(name, bytes.len() as u64).piece(bytes)
    }

    /// Begins a field of `len` bytes, which follow in [pieces](Self::piece) of any length.
    pub fn begin(&mut self, name: &str, len: u64) -> &mut Self {
        self.0.update(&(name.len() as u64).to_le_bytes());
        self.0.update(name.as_bytes());
        self.0.update(&len.to_le_bytes());
        self
    }

    /// Adds the next bytes of the field that was begun last.
    pub fn piece(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update(bytes);
        self
    }

    /// The digest of everything added.
    pub fn finish(&self) -> Digest {
        Digest::short(&self.0.finalize())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl serde::Serialize for Digest {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> serde::Deserialize<'de> for Digest {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <String as serde::Deserialize>::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl std::str::FromStr for Digest {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.len() != 32 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(format!("a digest has 32 hexadecimal digits, got `{text}`"));
        }
        let mut bytes = [0; 16];
        for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks(2)) {
            let pair = std::str::from_utf8(pair).expect("checked to be ASCII");
            *byte = u8::from_str_radix(pair, 16).expect("checked to be hexadecimal");
        }
        Ok(Self(bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_in_pieces_is_the_same_field() {
        let whole = DigestBuilder::new().field("a", b"bytes").field("b", b"").finish();
        let mut pieces = DigestBuilder::new();
        pieces.begin("a", 5).piece(b"by").piece(b"").piece(b"tes").begin("b", 0);
        assert_eq!(pieces.finish(), whole);
    }

    #[test]
    fn a_blocks_digest_begins_the_hash_of_its_bytes() {
        let numbers = [1.0_f32, -0.0, f32::MIN_POSITIVE];
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let hash = blake3::hash(&bytes).to_hex().to_string();
        assert_eq!(Digest::of_block(&numbers).to_string(), hash[..32]);
        assert_ne!(Digest::of_block(&[0.0]), Digest::of_block(&[-0.0]), "bits, not values");
    }

    #[test]
    fn text_and_bytes_round_trip() {
        let digest = DigestBuilder::new().field("a", b"bytes").finish();
        assert_eq!(digest.to_string().parse(), Ok(digest));
        assert!("zz".parse::<Digest>().is_err());
    }

    #[test]
    fn a_byte_that_moves_to_the_next_field_changes_the_digest() {
        let left = DigestBuilder::new().field("a", b"xy").field("b", b"z").finish();
        let right = DigestBuilder::new().field("a", b"x").field("b", b"yz").finish();
        assert_ne!(left, right);
    }
}
