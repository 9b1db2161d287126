//! The memory and the operands of the EV3's byte codes, and the codes that move, calculate and jump: the subset that clients use in
//! direct commands.
//!
//! ```text
//! 00vvvvvv            constant of six bits with a sign          10000sss ..   constant: 1 byte, 2, 3 is four bytes, 0 or 4 a text up to its zero
//! 01giiiii            variable i, g 1 global and 0 local        11g00sss ..   variable, its number in 1, 2 or 4 bytes
//!
//! 10..1F   add, subtract, multiply, divide    for each width        30..3F   move from a width to a width
//! 40..42   jump, if false, if true            64..7B   jump if <, >, =, !=, <=, >= for each width        8D 06   absolute value
//! ```
//! # Sources
//! LEGO MINDSTORMS EV3 firmware developer kit, byte codes: parameter encoding.

/// An invalid command: malformed, unknown, or outside the memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ExecutionFault;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OperandWidth {
    /// DATA8.
    Byte,
    /// DATA16.
    Word,
    /// DATA32.
    Long,
    /// DATAF.
    Real,
}

impl OperandWidth {
    /// In the order in which groups of byte codes use them.
    pub(super) const fn of(bits: u8) -> Self {
        match bits & 3 {
            0 => Self::Byte,
            1 => Self::Word,
            2 => Self::Long,
            _ => Self::Real,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Operand {
    Constant(i32),
    Text(Vec<u8>),
    Global(usize),
    Local(usize),
}

#[derive(Clone, Debug)]
pub(super) struct BytecodeMachine {
    code: Vec<u8>,
    pub(super) program_counter: usize,
    pub(super) globals: Vec<u8>,
    locals: Vec<u8>,
}

impl BytecodeMachine {
    /// A command that has not begun; its memory is zero.
    pub(super) fn new(code: &[u8], globals: usize, locals: usize) -> Self {
        Self { code: code.to_vec(), program_counter: 0, globals: vec![0; globals], locals: vec![0; locals] }
    }

    /// Relative, backward if negative.
    pub(super) fn jump(&mut self, by: i32) -> Result<(), ExecutionFault> {
        let program_counter = self.program_counter as i64 + i64::from(by);
        self.program_counter = usize::try_from(program_counter).map_err(|_before_the_code| ExecutionFault)?;
        Ok(())
    }

    pub(super) fn next_code(&mut self) -> Option<u8> {
        let code = self.code.get(self.program_counter).copied()?;
        self.program_counter += 1;
        Some(code)
    }

    pub(super) fn int(&mut self, width: OperandWidth) -> Result<i32, ExecutionFault> {
        match self.operand()? {
            Operand::Constant(value) => Ok(value),
            Operand::Text(_) => Err(ExecutionFault),
            Operand::Global(at) => load_int(&self.globals, at, width),
            Operand::Local(at) => load_int(&self.locals, at, width),
        }
    }

    /// The next operand as a small integer: a port, a layer, a percentage.
    pub(super) fn byte(&mut self) -> Result<i32, ExecutionFault> {
        self.int(OperandWidth::Byte)
    }

    /// The next operand as a real number. A constant holds its bits.
    pub(super) fn real(&mut self) -> Result<f32, ExecutionFault> {
        let bits = self.int(OperandWidth::Long)?;
        Ok(f32::from_bits(bits as u32))
    }

    pub(super) fn text(&mut self) -> Result<Vec<u8>, ExecutionFault> {
        match self.operand()? {
            Operand::Text(text) => Ok(text),
            Operand::Constant(_) | Operand::Global(_) | Operand::Local(_) => Err(ExecutionFault),
        }
    }

    pub(super) fn write_int(&mut self, width: OperandWidth, value: i32) -> Result<(), ExecutionFault> {
        let bytes = value.to_le_bytes();
        match width {
            OperandWidth::Byte => self.write_bytes(&bytes[..1]),
            OperandWidth::Word => self.write_bytes(&bytes[..2]),
            OperandWidth::Long | OperandWidth::Real => self.write_bytes(&bytes),
        }
    }

    pub(super) fn write_real(&mut self, value: f32) -> Result<(), ExecutionFault> {
        self.write_bytes(&value.to_le_bytes())
    }

    /// Writes a text with its final zero to the next operand, cut to `capacity` bytes.
    pub(super) fn write_text(&mut self, text: &str, capacity: i32) -> Result<(), ExecutionFault> {
        let capacity = usize::try_from(capacity).map_err(|_negative| ExecutionFault)?;
        let mut bytes: Vec<u8> = text.bytes().take(capacity.saturating_sub(1)).collect();
        if capacity > 0 {
            bytes.push(0);
        }
        self.write_bytes(&bytes)
    }

    fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), ExecutionFault> {
        let (memory, at) = match self.operand()? {
            Operand::Global(at) => (&mut self.globals, at),
            Operand::Local(at) => (&mut self.locals, at),
            Operand::Constant(_) | Operand::Text(_) => return Err(ExecutionFault),
        };
        let end = at.checked_add(bytes.len()).ok_or(ExecutionFault)?;
        memory.get_mut(at..end).ok_or(ExecutionFault)?.copy_from_slice(bytes);
        Ok(())
    }

    fn operand(&mut self) -> Result<Operand, ExecutionFault> {
        let head = self.next_code().ok_or(ExecutionFault)?;
        let is_global = head & 0x20 != 0;
        let variable = |at: usize| {
            if is_global { Operand::Global(at) } else { Operand::Local(at) }
        };
        match head >> 6 {
            // Six bits with a sign, moved up to the sign of a byte and back.
            0b00 => Ok(Operand::Constant(i32::from((head << 2) as i8 >> 2))),
            0b01 => Ok(variable(usize::from(head & 0x1F))),
            // Handles, addresses and labels are of no use in a direct command.
            _ if head & 0x18 != 0 => Err(ExecutionFault),
            0b10 if matches!(head & 7, 0 | 4) => self.text_constant().map(Operand::Text),
            0b10 => self.number(head & 7).map(Operand::Constant),
            _ => {
                let at = self.number(head & 7)?;
                let mask = if head & 7 == 1 { 0xFF } else { i32::MAX };
                Ok(variable((at & mask) as usize))
            }
        }
    }

    fn number(&mut self, size: u8) -> Result<i32, ExecutionFault> {
        let count = match size {
            1 => 1,
            2 => 2,
            3 => 4,
            _ => return Err(ExecutionFault),
        };
        let bytes = self.code.get(self.program_counter..self.program_counter + count).ok_or(ExecutionFault)?;
        self.program_counter += count;
        match *bytes {
            [a] => Ok(i32::from(a as i8)),
            [a, b] => Ok(i32::from(i16::from_le_bytes([a, b]))),
            [a, b, c, d] => Ok(i32::from_le_bytes([a, b, c, d])),
            _ => Err(ExecutionFault),
        }
    }

    fn text_constant(&mut self) -> Result<Vec<u8>, ExecutionFault> {
        let rest = self.code.get(self.program_counter..).ok_or(ExecutionFault)?;
        let length = rest.iter().position(|byte| *byte == 0).ok_or(ExecutionFault)?;
        let text = rest.get(..length).ok_or(ExecutionFault)?.to_vec();
        self.program_counter += length + 1;
        Ok(text)
    }
}

fn load_int(memory: &[u8], at: usize, width: OperandWidth) -> Result<i32, ExecutionFault> {
    let rest = memory.get(at..).ok_or(ExecutionFault)?;
    let loaded = match width {
        OperandWidth::Byte => rest.first().map(|byte| i32::from(*byte as i8)),
        OperandWidth::Word => rest.first_chunk().map(|bytes| i32::from(i16::from_le_bytes(*bytes))),
        OperandWidth::Long | OperandWidth::Real => rest.first_chunk().map(|bytes| i32::from_le_bytes(*bytes)),
    };
    loaded.ok_or(ExecutionFault)
}

enum Number {
    Integer(i32),
    Real(f32),
}

/// Executes a byte code of these groups; `None` if it belongs to another group.
pub(super) fn calculate(code: u8, machine: &mut BytecodeMachine) -> Option<Result<(), ExecutionFault>> {
    match code {
        0x10..=0x1F => Some(combine((code - 0x10) >> 2, OperandWidth::of(code), machine)),
        0x30..=0x3F => Some(convert(OperandWidth::of((code - 0x30) >> 2), OperandWidth::of(code), machine)),
        0x40..=0x42 => Some(jump(code, machine)),
        0x64..=0x7B => Some(jump_compared((code - 0x64) >> 2, OperandWidth::of(code), machine)),
        _ => None,
    }
}

/// MATH: only the absolute value.
pub(super) fn math(machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    const ABSOLUTE: i32 = 6;
    if machine.byte()? != ABSOLUTE {
        return Err(ExecutionFault);
    }
    let value = machine.real()?;
    machine.write_real(value.abs())
}

fn load(width: OperandWidth, machine: &mut BytecodeMachine) -> Result<Number, ExecutionFault> {
    if width == OperandWidth::Real { machine.real().map(Number::Real) } else { machine.int(width).map(Number::Integer) }
}

fn combine(operation: u8, width: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    match (load(width, machine)?, load(width, machine)?) {
        (Number::Real(a), Number::Real(b)) => machine.write_real(match operation {
            0 => a + b,
            1 => a - b,
            2 => a * b,
            _ => a / b,
        }),
        (Number::Integer(a), Number::Integer(b)) => {
            let result = match operation {
                0 => a.wrapping_add(b),
                1 => a.wrapping_sub(b),
                2 => a.wrapping_mul(b),
                _ => a.checked_div(b).unwrap_or(0),
            };
            machine.write_int(width, result)
        }
        (Number::Real(_), Number::Integer(_)) | (Number::Integer(_), Number::Real(_)) => Err(ExecutionFault),
    }
}

fn convert(from: OperandWidth, to: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    match (load(from, machine)?, to) {
        (Number::Integer(value), OperandWidth::Real) => machine.write_real(value as f32),
        (Number::Integer(value), _) => machine.write_int(to, value),
        (Number::Real(value), OperandWidth::Real) => machine.write_real(value),
        (Number::Real(value), OperandWidth::Byte) => machine.write_int(to, i32::from(value as i8)),
        (Number::Real(value), OperandWidth::Word) => machine.write_int(to, i32::from(value as i16)),
        (Number::Real(value), OperandWidth::Long) => machine.write_int(to, value as i32),
    }
}

fn jump(code: u8, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    let is_taken = match code {
        0x40 => true,
        0x41 => machine.byte()? == 0,
        _ => machine.byte()? != 0,
    };
    let by = machine.int(OperandWidth::Long)?;
    if is_taken { machine.jump(by) } else { Ok(()) }
}

fn jump_compared(comparison: u8, width: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    let order = match (load(width, machine)?, load(width, machine)?) {
        (Number::Real(a), Number::Real(b)) => a.partial_cmp(&b),
        (Number::Integer(a), Number::Integer(b)) => Some(a.cmp(&b)),
        (Number::Real(_), Number::Integer(_)) | (Number::Integer(_), Number::Real(_)) => None,
    };
    let is_taken = order.is_some_and(|order| match comparison {
        0 => order.is_lt(),
        1 => order.is_gt(),
        2 => order.is_eq(),
        3 => order.is_ne(),
        4 => order.is_le(),
        _ => order.is_ge(),
    });
    let by = machine.int(OperandWidth::Long)?;
    if is_taken { machine.jump(by) } else { Ok(()) }
}
