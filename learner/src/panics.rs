//! What a panic says: in one line, as the end of a log is what people are shown.

use std::io::Write as _;
use std::panic::{self, PanicHookInfo};

/// Where libtorch's errors turn into a list of addresses, about thirty lines of them.
const ADDRESSES: &str = "Exception raised from";

/// Has panics of this process end up in its log without libtorch's addresses. Who sets `RUST_BACKTRACE` sees all of them.
pub fn log() {
    let whole = panic::take_hook();
    panic::set_hook(Box::new(move |panic: &PanicHookInfo<'_>| {
        // Whatever is filtered of the log. Nobody is left to be told if this fails.
        let _ = writeln!(std::io::stderr(), "{}", brief(&panic.to_string()));
        if std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0") {
            whole(panic);
        }
    }));
}

/// `text` in one line, up to libtorch's addresses. Errors that were unwrapped have their line breaks escaped.
fn brief(text: &str) -> String {
    let said = text.split(ADDRESSES).next().unwrap_or_default().replace("\\n", "\n");
    let words: Vec<&str> = said.split_whitespace().collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, Tensor};

    use super::*;

    #[test]
    fn an_error_of_libtorch_is_one_line_without_addresses() {
        let [two, three] = [2, 3].map(|n| Tensor::zeros([n], (Kind::Float, Device::Cpu)));
        let error = two.f_add(&three).expect_err("of other sizes");
        for text in [error.to_string(), format!("panicked at a.rs:1:2:\n{error:?}")] {
            let told = brief(&text);
            assert!(told.contains("The size of tensor a (2) must match"), "{told}");
            assert!(!told.contains("frame #") && !told.contains('\n'), "{told}");
        }
        assert_eq!(brief("panicked at a.rs:1:2:\nan order"), "panicked at a.rs:1:2: an order");
    }
}
