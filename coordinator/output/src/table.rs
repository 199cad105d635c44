//! Tables that fit: cells of words are wrapped, and columns for which there is no room follow below.

use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, Width, presets};
use unicode_width::UnicodeWidthStr as _;

/// Columns of a terminal that does not say how wide it is, of a file, and of a page.
pub const COLUMNS: usize = 80;
/// No table gets narrower than this, whatever a terminal says.
const LEAST: usize = 40;
/// Spaces between columns.
const GAP: usize = 2;
/// A column as narrow as this is a number or a word, and is not wrapped.
const NARROW: usize = 14;
/// Words that are longer than this are paths, and may be broken; others may be names.
const NAME: usize = 24;

/// How wide a line on standard output may be.
pub fn columns() -> usize {
    // Nothing, where standard output is no terminal.
    Table::new().width().map_or(COLUMNS, |columns| usize::from(columns).max(LEAST))
}

/// A table whose first column holds names and whose others hold numbers, for standard output.
pub fn table<const N: usize>(
    header: [&str; N],
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    table_within(columns(), header, rows)
}

/// The same, in lines of at most `columns` characters.
pub fn table_within<const N: usize>(
    columns: usize,
    header: [&str; N],
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    let rows: Vec<[String; N]> = rows.into_iter().collect();
    let widths: [usize; N] = std::array::from_fn(|column| {
        let cells = rows.iter().map(|row| width(&row[column]));
        cells.chain([width(header[column])]).max().unwrap_or(0)
    });
    let words: [usize; N] = std::array::from_fn(|column| {
        let cells = rows.iter().map(|row| longest_word(&row[column]));
        cells.chain([longest_word(header[column])]).max().unwrap_or(0)
    });
    let bands = bands(&widths, columns);
    let bands = bands.iter().map(|band| {
        let fitted = fitted(band, &widths, &words, columns);
        let cells = |row: &[String]| band.iter().map(|at| row[*at].clone()).collect::<Vec<_>>();
        let header = header.map(str::to_owned);
        draw(&cells(&header), rows.iter().map(|row| cells(row)), band, &fitted)
    });
    bands.collect::<Vec<_>>().join("\n\n")
}

fn width(text: &str) -> usize {
    text.lines().map(str::width).max().unwrap_or(0)
}

/// Width of the longest word that shall stay whole.
fn longest_word(text: &str) -> usize {
    text.split_whitespace().map(str::width).filter(|width| *width <= NAME).max().unwrap_or(0)
}

/// How many characters columns take beside each other.
fn total(widths: impl Iterator<Item = usize>) -> usize {
    widths.map(|width| width + GAP).sum::<usize>().saturating_sub(GAP)
}

/// The narrowest that a column of this width can become.
fn least(width: usize) -> usize {
    width.min(NARROW)
}

/// Which columns stand beside each other. All do, if there is room for them when long cells are wrapped; else those
/// that have none follow below in further bands, behind the first column again.
fn bands(widths: &[usize], columns: usize) -> Vec<Vec<usize>> {
    if total(widths.iter().map(|width| least(*width))) <= columns {
        return vec![(0..widths.len()).collect()];
    }
    let mut bands = vec![vec![0]];
    for column in 1..widths.len() {
        let band = bands.last_mut().expect("there is one from the beginning");
        let wider = total(band.iter().chain([&column]).map(|at| widths[*at]));
        if band.len() == 1 || wider <= columns {
            band.push(column);
        } else {
            bands.push(vec![0, column]);
        }
    }
    bands
}

/// Widths at which the columns of a band fit: the widest give way first, and narrow ones only to keep words whole, such as the
/// name of a checkpoint. Words are broken where it does not fit otherwise.
fn fitted(band: &[usize], widths: &[usize], words: &[usize], columns: usize) -> Vec<usize> {
    let mut fitted: Vec<usize> = band.iter().map(|at| widths[*at]).collect();
    let words: Vec<usize> = band.iter().map(|at| words[*at]).collect();
    let wide_enough = words.iter().map(|word| NARROW.max(*word)).collect();
    for least in [wide_enough, words, vec![NARROW; band.len()]] {
        while total(fitted.iter().copied()) > columns {
            let wide = fitted.iter_mut().zip(&least).filter(|(width, least)| **width > **least);
            match wide.max_by_key(|(width, _)| **width) {
                Some((width, _)) => *width -= 1,
                None => break,
            }
        }
    }
    fitted
}

fn draw(
    header: &[String],
    rows: impl Iterator<Item = Vec<String>>,
    band: &[usize],
    widths: &[usize],
) -> String {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING).set_header(header).add_rows(rows);
    table.set_content_arrangement(ContentArrangement::Disabled);
    for (column, width) in table.column_iter_mut().zip(widths) {
        column.set_padding((0, GAP as u16));
        column.set_constraint(ColumnConstraint::Absolute(Width::Fixed((width + GAP) as u16)));
        if band[column.index] > 0 {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    let lines: Vec<_> = table.lines().map(|line| line.trim_end().to_owned()).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn widest(text: &str) -> usize {
        text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
    }

    fn rows<const N: usize>(rows: &[[&str; N]]) -> Vec<[String; N]> {
        rows.iter().map(|row| row.map(str::to_owned)).collect()
    }

    #[test]
    fn a_table_that_fits_is_as_wide_as_its_cells() {
        let text = table_within(80, ["error", "min"], rows(&[["position", "1.5"], ["x", "12.5"]]));
        assert_eq!(text, "error      min\nposition   1.5\nx         12.5");
    }

    /// Such characters take two columns of a terminal each.
    #[test]
    fn wide_characters_have_room() {
        let text = table_within(80, ["run", "state"], rows(&[["実行/軌道", "running"]]));
        assert_eq!(text, "run          state\n実行/軌道  running");
    }

    #[test]
    fn words_are_wrapped_before_columns_are_moved() {
        let long = "avx512f avx512bw avx512vl avx512dq avx512vnni avx512_bf16 amx_tile amx_bf16";
        let row = ["vector_extensions", long, "avx2 fma"];
        let text = table_within(60, ["provenance", "first", "second"], rows(&[row]));
        assert!(widest(&text) <= 60, "{text}");
        assert!(text.lines().count() > 2 && !text.contains("\n\n"), "{text}");
        for word in long.split(' ').chain(["vector_extensions"]) {
            assert!(text.contains(word), "{word} is not whole in\n{text}");
        }
    }

    #[test]
    fn columns_without_room_follow_below_behind_the_names() {
        let header = ["figure", "a", "b", "c", "d"];
        let row = ["rate", "1,234,567", "2,345,678", "3,456,789", "4,567,890"];
        let text = table_within(40, header, rows(&[row]));
        assert!(widest(&text) <= 40, "{text}");
        let bands: Vec<&str> = text.split("\n\n").collect();
        assert_eq!(bands.len(), 2, "{text}");
        assert!(
            bands.iter().all(|band| band.contains("rate") && band.contains("figure")),
            "{text}"
        );
        assert!(row.iter().all(|cell| text.contains(cell)), "{text}");
    }

    /// They are typed again, or picked up by a double click.
    #[test]
    fn names_stay_whole_where_words_beside_them_can_be_wrapped() {
        let header = ["name", "iteration", "labels", "age"];
        let row = ["iteration-00000100", "100", "pinned, best, latest", "3 min"];
        let text = table_within(48, header, rows(&[row]));
        assert!(widest(&text) <= 48 && !text.contains("\n\n"), "{text}");
        for word in row.iter().flat_map(|cell| cell.split(' ')) {
            assert!(text.contains(word), "{word} is not whole in\n{text}");
        }
    }

    #[test]
    fn a_name_without_spaces_is_broken_rather_than_let_out() {
        let path = "/a/very/long/path/without/any/space/in/it/that/goes/on/and/on/and/on/run";
        let text = table_within(50, ["run", "state"], rows(&[[path, "running"]]));
        assert!(widest(&text) <= 50, "{text}");
        let all: String = text.split_whitespace().filter(|word| word.contains('/')).collect();
        assert!(all.ends_with("run") && all.len() == path.len(), "{text}");
    }
}
