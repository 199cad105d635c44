//! Films read back by the decoders of the crates; `tests/it/film.rs` has another program read them.

use std::io::Cursor;

use super::*;

const SIZE: [usize; 2] = [41, 27];

/// A square that moves over a ground of two colours, and stands still once.
fn pictures() -> Vec<Image> {
    let picture = |step: usize| {
        let mut image = Image::filled(SIZE[0], SIZE[1], [250, 250, 245]);
        for y in 5..12 {
            for x in 3 * step + 1..3 * step + 8 {
                image.pixels[y * SIZE[0] + x] = [10 * step as u8, 90, 200];
            }
        }
        image
    };
    [0, 1, 2, 2, 5].map(picture).into()
}

fn film(format: Format) -> Vec<u8> {
    let pictures = pictures();
    let mut film = Film::new(format, SIZE, pictures.len() as u32, &pictures).expect("begun");
    for (index, picture) in pictures.iter().enumerate() {
        film.add(picture, 70 * (index as u64 + 1)).expect("added");
    }
    film.finish().expect("a film")
}

/// Draws red, green, blue and cover over a picture.
fn draw_over(shown: &mut Image, [left, top, width]: [usize; 3], rgba: &[u8]) {
    for (index, pixel) in rgba.chunks_exact(4).enumerate() {
        if pixel[3] == 255 {
            let at = (top + index / width) * SIZE[0] + left + index % width;
            shown.pixels[at] = [pixel[0], pixel[1], pixel[2]];
        }
    }
}

#[test]
fn a_gif_is_read_back() {
    let file = film(Format::Gif);
    assert!(file.starts_with(Format::Gif.mark()));
    let mut options = ::gif::DecodeOptions::new();
    options.set_color_output(::gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(Cursor::new(file)).expect("a GIF");
    assert_eq!(decoder.repeat(), ::gif::Repeat::Infinite);
    let mut shown = Image::filled(SIZE[0], SIZE[1], [0; 3]);
    for picture in pictures() {
        let frame = decoder.read_next_frame().expect("readable").expect("a picture");
        assert_eq!(frame.delay, 7);
        let place = [frame.left, frame.top, frame.width].map(usize::from);
        draw_over(&mut shown, place, &frame.buffer);
        assert_eq!(shown, picture);
    }
    assert!(decoder.read_next_frame().expect("readable").is_none());
}

#[test]
fn an_apng_is_read_back() {
    let file = film(Format::Apng);
    assert!(file.starts_with(Format::Apng.mark()));
    let mut reader = png::Decoder::new(Cursor::new(file)).read_info().expect("a PNG");
    let control = reader.info().animation_control.expect("an animation");
    assert_eq!((control.num_frames, control.num_plays), (5, 0));
    let mut shown = Image::filled(SIZE[0], SIZE[1], [0; 3]);
    let mut buffer = vec![0; 4 * SIZE[0] * SIZE[1]];
    for picture in pictures() {
        let info = reader.next_frame(&mut buffer).expect("a picture");
        let frame = reader.info().frame_control.expect("its place");
        assert_eq!((frame.delay_num, frame.delay_den), (70, 1000));
        let place = [frame.x_offset, frame.y_offset, frame.width].map(|n| n as usize);
        draw_over(&mut shown, place, &buffer[..info.buffer_size()]);
        assert_eq!(shown, picture);
    }
}

#[test]
fn a_webp_is_read_back() {
    let file = film(Format::WebP);
    assert!(file.starts_with(Format::WebP.mark()));
    let mut decoder = image_webp::WebPDecoder::new(Cursor::new(file)).expect("a WebP");
    assert!(decoder.is_animated());
    assert_eq!(decoder.num_frames(), 5);
    assert_eq!(decoder.loop_count(), image_webp::LoopCount::Forever);
    let mut buffer = vec![0; decoder.output_buffer_size().expect("a size")];
    for picture in pictures() {
        assert_eq!(decoder.read_frame(&mut buffer).expect("a picture"), 70);
        let channels = buffer.len() / (SIZE[0] * SIZE[1]);
        for (pixel, wanted) in buffer.chunks_exact(channels).zip(&picture.pixels) {
            // This decoder draws opaque pixels over others with an error of one level.
            assert!((0..3).all(|i| pixel[i].abs_diff(wanted[i]) <= 1), "{pixel:?} {wanted:?}");
        }
    }
}

#[test]
fn the_same_pictures_give_the_same_file() {
    for format in Format::ALL {
        assert_eq!(film(format), film(format), "{}", format.name());
        assert_eq!(Format::of_extension(&format.name().to_lowercase()), Some(format));
    }
    assert_eq!(Format::of_extension("PNG"), Some(Format::Apng));
    assert_eq!(Format::of_extension("svg"), None);
}

#[test]
fn a_picture_that_no_format_holds_is_refused() {
    for size in [[0, 5], [70_000, 5]] {
        for format in Format::ALL {
            let error = Film::new(format, size, 1, &[]).expect_err("too small or too large");
            assert!(error.to_string().contains(format.name()), "{error}");
        }
    }
}
