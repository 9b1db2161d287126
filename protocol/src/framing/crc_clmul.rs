//! The checksum by carry-less multiplication (PCLMULQDQ), sixteen bytes per step.
//!
//! The one place in the house with `unsafe`: calling a function that is compiled for an instruction which not every
//! processor has. It is called only after the processor was asked.
//!
//! # Model
//! ```text
//! A block of 16 bytes is a polynomial A over GF(2), first byte = highest powers, each byte's lowest bit first.
//! Shifting it 128 bits ahead:  A·x^128 = lo·x^192 + hi·x^128  (mod P),   A = lo·x^64 + hi
//! The multiplier works on reversed bits and so returns the product times x: the constants are one power lower.
//! ```
//! # Sources
//! Gopal et al. (2009), "Fast CRC Computation for Generic Polynomials Using PCLMULQDQ Instruction", Intel.

#![expect(unsafe_code, reason = "calling a function with target features needs unsafe; the processor is asked first")]

use std::arch::x86_64::{
    __m128i, _mm_clmulepi64_si128, _mm_cvtsi128_si64, _mm_set_epi64x, _mm_srli_si128, _mm_xor_si128,
};
use std::is_x86_feature_detected;

/// The generator polynomial without its leading term, x^12 + x^5 + 1.
const POLYNOMIAL: u16 = 0x1021;
/// x^191 and x^127 modulo the polynomial, bits reversed in 64: the factors for the first and the second half of a block.
const FACTORS: [u64; 2] = [power_reversed(191), power_reversed(127)];
const BLOCK: usize = 16;

/// x^exponent modulo the polynomial, as 64 reversed bits.
const fn power_reversed(exponent: u32) -> u64 {
    let mut remainder = 1_u16;
    let mut power = 0;
    while power < exponent {
        let carry = remainder & 0x8000 != 0;
        remainder <<= 1;
        if carry {
            remainder ^= POLYNOMIAL;
        }
        power += 1;
    }
    (remainder as u64).reverse_bits()
}

/// Continues the sum `crc` over `bytes`; `None` when the processor cannot or `bytes` is shorter than one block.
#[inline]
pub(super) fn folded(crc: u16, bytes: &[u8]) -> Option<u16> {
    if !is_x86_feature_detected!("pclmulqdq") {
        return None;
    }
    // SAFETY: `fold` needs SSE2, which every x86-64 processor has, and PCLMULQDQ, which was just asked for. It reads only
    // through slices.
    unsafe { fold(crc, bytes) }
}

#[target_feature(enable = "sse2,pclmulqdq")]
fn fold(crc: u16, bytes: &[u8]) -> Option<u16> {
    let (blocks, rest) = bytes.as_chunks::<BLOCK>();
    let (first, blocks) = blocks.split_first()?;
    let factors = _mm_set_epi64x(FACTORS[1] as i64, FACTORS[0] as i64);
    let start = _mm_set_epi64x(0, i64::from(crc));
    let mut sum = _mm_xor_si128(load(first), start);
    for block in blocks {
        let ahead = _mm_xor_si128(_mm_clmulepi64_si128(sum, factors, 0x00), _mm_clmulepi64_si128(sum, factors, 0x11));
        sum = _mm_xor_si128(ahead, load(block));
    }
    Some(super::crc::sliced(super::crc::sliced(0, &store(sum)), rest))
}

#[target_feature(enable = "sse2")]
fn load(block: &[u8; BLOCK]) -> __m128i {
    let value = u128::from_le_bytes(*block);
    _mm_set_epi64x((value >> 64) as i64, value as i64)
}

#[target_feature(enable = "sse2")]
fn store(value: __m128i) -> [u8; BLOCK] {
    let low = _mm_cvtsi128_si64(value) as u64;
    let high = _mm_cvtsi128_si64(_mm_srli_si128(value, 8)) as u64;
    (u128::from(low) | (u128::from(high) << 64)).to_le_bytes()
}
