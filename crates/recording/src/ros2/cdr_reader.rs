//! Reads ROS 2 messages: CDR of either byte order, as far as the bytes go and not as far as the counts in them claim.
//!
//! Sources: OMG DDS-RTPS 2.5, 10.2 (the header: representations `CDR_BE` 0 and `CDR_LE` 1) and CORBA 3.3, 9.3 (alignment, texts,
//! sequences).

/// Bytes of the encapsulation header, from whose end alignment counts.
const HEADER_BYTES: usize = 4;

/// Why a message cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("byte {offset} of the message: {what}")]
pub struct CdrError {
    /// From the first byte of its header.
    offset: usize,
    what: String,
}

#[derive(Clone, Copy, Debug)]
enum ByteOrder {
    Big,
    Little,
}

/// Reads the fields of one message in the order of its definition.
#[derive(Clone, Debug)]
pub(super) struct CdrReader<'a> {
    message: &'a [u8],
    offset: usize,
    order: ByteOrder,
}

macro_rules! number {
    ($name:ident, $type:ty) => {
        pub(super) fn $name(&mut self) -> Result<$type, CdrError> {
            let bytes = self.aligned(stringify!($type))?;
            Ok(match self.order {
                ByteOrder::Big => <$type>::from_be_bytes(bytes),
                ByteOrder::Little => <$type>::from_le_bytes(bytes),
            })
        }
    };
}

impl<'a> CdrReader<'a> {
    /// # Errors
    /// The header is cut off, or of another representation, as those with parameter lists.
    pub(super) fn open(message: &'a [u8]) -> Result<Self, CdrError> {
        let order = match message {
            [0, 0, _, _, ..] => ByteOrder::Big,
            [0, 1, _, _, ..] => ByteOrder::Little,
            [high, low, _, _, ..] => {
                let what = format!("representation 0x{high:02x}{low:02x} is not plain CDR (0x0000 and 0x0001)");
                return Err(CdrError { offset: 0, what });
            }
            _ => {
                let what = format!("the header has 4 bytes and the message {}", message.len());
                return Err(CdrError { offset: 0, what });
            }
        };
        Ok(Self { message, offset: HEADER_BYTES, order })
    }

    number!(i32, i32);
    number!(u32, u32);
    number!(f32, f32);
    number!(f64, f64);

    /// A fixed array: no count before it.
    pub(super) fn doubles<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], CdrError> {
        let mut values = [0.0; COUNT];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// The count includes the zero at the end; some writers leave both out of an empty text.
    pub(super) fn text(&mut self) -> Result<&'a str, CdrError> {
        let offset = self.offset;
        let count = self.count(1, "text")?;
        let bytes = self.take(count, "text")?;
        let text = match bytes {
            [] => Some(""),
            [text @ .., 0] => std::str::from_utf8(text).ok(),
            _ => None,
        };
        text.ok_or_else(|| CdrError { offset, what: "a text that is not UTF-8 with a zero at its end".to_owned() })
    }

    /// The count before the elements of a sequence, each of which has at least so many bytes.
    pub(super) fn count(&mut self, least_bytes: usize, what: &str) -> Result<usize, CdrError> {
        let count = self.u32()? as usize;
        let left = self.message.len() - self.offset;
        if count.saturating_mul(least_bytes) <= left {
            return Ok(count);
        }
        let offset = self.offset - size_of::<u32>();
        Err(CdrError { offset, what: format!("a {what} of {count} elements, but {left} bytes are left") })
    }

    /// A sequence of numbers, unread.
    pub(super) fn sequence(&mut self, element_bytes: usize) -> Result<Sequence<'a>, CdrError> {
        let count = self.count(element_bytes, "sequence")?;
        if count > 0 {
            self.align(element_bytes)?;
        }
        let bytes = self.take(count * element_bytes, "sequence")?;
        Ok(Sequence { bytes, count, order: self.order })
    }

    fn aligned<const SIZE: usize>(&mut self, what: &str) -> Result<[u8; SIZE], CdrError> {
        self.align(SIZE)?;
        let offset = self.offset;
        let bytes = self.take(SIZE, what)?;
        bytes.first_chunk().copied().ok_or_else(|| CdrError { offset, what: format!("a {what} is cut off") })
    }

    fn align(&mut self, size: usize) -> Result<(), CdrError> {
        let aligned = (self.offset - HEADER_BYTES).next_multiple_of(size) + HEADER_BYTES;
        self.take(aligned - self.offset, "gap").map(drop)
    }

    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], CdrError> {
        let rest = self.message.get(self.offset..).unwrap_or_default();
        let taken = rest.get(..count).ok_or_else(|| {
            let what = format!("a {what} of {count} bytes, but {} are left", rest.len());
            CdrError { offset: self.offset, what }
        })?;
        self.offset += count;
        Ok(taken)
    }
}

/// The numbers of a sequence, unread.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sequence<'a> {
    bytes: &'a [u8],
    count: usize,
    order: ByteOrder,
}

impl Sequence<'_> {
    pub(super) const fn count(&self) -> usize {
        self.count
    }

    /// Of a sequence of `float64`.
    pub(super) fn double(&self, index: usize) -> Option<f64> {
        let bytes = *self.bytes.get(index.checked_mul(8)?..)?.first_chunk()?;
        Some(match self.order {
            ByteOrder::Big => f64::from_be_bytes(bytes),
            ByteOrder::Little => f64::from_le_bytes(bytes),
        })
    }

    /// Of a sequence of `float32`.
    pub(super) fn single(&self, index: usize) -> Option<f32> {
        let bytes = *self.bytes.get(index.checked_mul(4)?..)?.first_chunk()?;
        Some(match self.order {
            ByteOrder::Big => f32::from_be_bytes(bytes),
            ByteOrder::Little => f32::from_le_bytes(bytes),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A text, a number and a sequence in both byte orders, by hand from CORBA 3.3, 9.3.
    const LITTLE: &[u8] = b"\0\x01\0\0\x03\0\0\0ab\0\0\0\0\0\0\0\0\xF8\x3F\x02\0\0\0\0\0\x80\x3F\0\0\0\xC0";
    const BIG: &[u8] = b"\0\0\0\0\0\0\0\x03ab\0\0\x3F\xF8\0\0\0\0\0\0\0\0\0\x02\x3F\x80\0\0\xC0\0\0\0";

    fn read(message: &[u8]) -> Result<(String, f64, Vec<f32>), CdrError> {
        let mut reader = CdrReader::open(message)?;
        let (text, number, sequence) = (reader.text()?.to_owned(), reader.f64()?, reader.sequence(4)?);
        Ok((text, number, (0..sequence.count()).filter_map(|index| sequence.single(index)).collect()))
    }

    #[test]
    fn both_byte_orders_are_read_and_every_cut_is_an_error() {
        for message in [LITTLE, BIG] {
            assert_eq!(read(message), Ok(("ab".to_owned(), 1.5, vec![1.0, -2.0])));
            for length in 0..message.len() {
                let error = read(&message[..length]).unwrap_err();
                assert!(error.offset <= length, "{length}: {error}");
            }
        }
    }

    #[test]
    fn a_count_that_lies_is_refused_before_anything_is_held() {
        let mut message = LITTLE.to_vec();
        message[20..24].fill(0xFF);
        let error = read(&message).unwrap_err();
        assert_eq!(
            error.to_string(),
            "byte 20 of the message: a sequence of 4294967295 elements, but 8 bytes are left"
        );
        message[4..8].fill(0xFF);
        assert_eq!(read(&message).unwrap_err().offset, 4);
    }

    #[test]
    fn other_representations_and_texts_without_end_are_refused() {
        assert!(read(b"\0\x03\0\0").unwrap_err().to_string().contains("representation 0x0003"));
        let mut message = LITTLE.to_vec();
        message[10] = b'c';
        assert!(read(&message).unwrap_err().to_string().contains("zero at its end"));
    }
}
