"""Makes the files of this folder with OpenCV and ffmpeg: pip install opencv-python-headless imageio-ffmpeg, then python3 make_recorded.py

NAME.y4m, NAME.avi, NAME.png and NAME.jpg are what is read; NAME.grey has the pixels that ffmpeg (OpenCV for PNG) decodes from it, a byte
each, frame after frame.
"""

import pathlib
import subprocess

import cv2
import imageio_ffmpeg
import numpy as np

FFMPEG = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-loglevel", "error", "-y"]
# Odd sides, so that the planes of colour are rounded up.
Y4M_SIZE = (17, 13)
Y4M_FORMATS = {
    "420jpeg": ["-pix_fmt", "yuv420p", "-chroma_sample_location", "center"],
    "420mpeg2": ["-pix_fmt", "yuv420p", "-chroma_sample_location", "left"],
    "420paldv": ["-pix_fmt", "yuv420p", "-chroma_sample_location", "topleft"],
    "411": ["-pix_fmt", "yuv411p"],
    "422": ["-pix_fmt", "yuv422p"],
    "444": ["-pix_fmt", "yuv444p"],
    "mono": ["-pix_fmt", "gray"],
    "420p10": ["-pix_fmt", "yuv420p10le", "-strict", "-1"],
}
AVI_SIZE = (48, 32)
AVI_FRAMES = 3
PNG_SIZE = (19, 11)


def ffmpeg(*arguments, stdin=None):
    return subprocess.run([*FFMPEG, *arguments], input=stdin, check=True, capture_output=True).stdout


def picture(size, number):
    """A gradient with a bright bar that wanders, in colour."""
    width, height = size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    colour = np.stack([255 * x / width, 255 * y / height, 255 * (x + y) / (width + height)], axis=-1)
    colour[:, 3 + 4 * number : 6 + 4 * number] = (250, 240, 40)
    return np.round(colour).astype(np.uint8)


def make_y4m():
    raw = b"".join(picture(Y4M_SIZE, number).tobytes() for number in range(2))
    size = "{}x{}".format(*Y4M_SIZE)
    for name, options in Y4M_FORMATS.items():
        source = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", size, "-r", "30000/1001", "-i", "-"]
        if name == "420mpeg2":
            options = [*options, "-color_range", "pc"]
        ffmpeg(*source, *options, "-f", "yuv4mpegpipe", f"{name}.y4m", stdin=raw)
        if name != "420p10":
            planes = ["-vf", "extractplanes=y"] if name != "mono" else []
            ffmpeg("-i", f"{name}.y4m", *planes, "-f", "rawvideo", f"{name}.grey")


def decode_luma(name):
    ffmpeg("-i", name, "-map", "0:v", "-fps_mode", "passthrough", "-vf", "extractplanes=y", "-f", "rawvideo", f"{pathlib.Path(name).stem}.grey")


def make_avi():
    # It rounds rates to whole numbers.
    writer = cv2.VideoWriter("opencv.avi", cv2.CAP_OPENCV_MJPEG, cv2.VideoWriter_fourcc(*"MJPG"), 12, AVI_SIZE)
    assert writer.isOpened()
    for number in range(AVI_FRAMES):
        writer.write(picture(AVI_SIZE, number))
    writer.release()
    decode_luma("opencv.avi")
    # Sound first, so that the pictures are the second stream, and an odd count of bytes in some chunks.
    raw = b"".join(picture(AVI_SIZE, number).tobytes() for number in range(AVI_FRAMES))
    size = "{}x{}".format(*AVI_SIZE)
    video = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", size, "-r", "30000/1001", "-i", "-"]
    sound = ["-f", "lavfi", "-t", "0.1", "-i", "sine=frequency=440:sample_rate=8000"]
    codec = ["-c:v", "mjpeg", "-q:v", "3", "-pix_fmt", "yuvj420p", "-c:a", "pcm_u8", "-fflags", "+bitexact", "-flags", "+bitexact"]
    ffmpeg(*video, *sound, "-map", "1:a", "-map", "0:v", *codec, "ffmpeg.avi", stdin=raw)
    decode_luma("ffmpeg.avi")
    # Without a place to return to, sizes and indices stay empty.
    piped = ffmpeg(*video, "-c:v", "mjpeg", "-q:v", "3", "-pix_fmt", "yuvj420p", "-f", "avi", "-", stdin=raw)
    pathlib.Path("piped.avi").write_bytes(piped)
    decode_luma("piped.avi")
    ffmpeg(*video, "-c:v", "mpeg4", "-frames:v", "1", "other_codec.avi", stdin=raw)
    make_two_riffs()


def make_two_riffs():
    """The frames of opencv.avi in two RIFF chunks, as OpenDML cuts files above a gigabyte; ffmpeg must still read all."""
    data = pathlib.Path("opencv.avi").read_bytes()
    movi = data.index(b"movi") - 8
    at = movi + 12
    chunks = []
    while data[at : at + 4] == b"00dc":
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        chunks.append(data[at : at + 8 + size + size % 2])
        at += len(chunks[-1])
    assert len(chunks) == AVI_FRAMES
    pack = lambda name, kind, body: name + (4 + len(body)).to_bytes(4, "little") + kind + body
    first = pack(b"RIFF", b"AVI ", data[12:movi] + pack(b"LIST", b"movi", chunks[0]))
    second = pack(b"RIFF", b"AVIX", pack(b"LIST", b"movi", b"".join(chunks[1:])))
    pathlib.Path("two_riffs.avi").write_bytes(first + second)
    decoded = ffmpeg("-i", "two_riffs.avi", "-fps_mode", "passthrough", "-vf", "extractplanes=y", "-f", "rawvideo", "-")
    assert decoded == pathlib.Path("opencv.grey").read_bytes()


def make_jpeg_without_tables():
    """As many webcams send: the standard Huffman tables, left out."""
    colour = picture(AVI_SIZE, 0)
    # OpenCV takes the standard tables unless it is asked to optimise.
    data = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
    kept, at = data[:2], 2
    while data[at + 1] != 0xDA:
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at + 1] != 0xC4:
            kept += data[at:end]
        at = end
    pathlib.Path("no_tables.jpg").write_bytes(kept + data[at:])
    decode_luma("no_tables.jpg")


def make_png():
    colour = picture(PNG_SIZE, 0)
    grey = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
    alpha = np.tile(np.arange(PNG_SIZE[0], dtype=np.uint8) * 13, (PNG_SIZE[1], 1))
    deep = lambda values: values.astype(np.uint16) * 256 + 77
    cv2.imwrite("grey8.png", grey)
    cv2.imwrite("grey16.png", deep(grey))
    cv2.imwrite("rgb8.png", colour)
    cv2.imwrite("rgb16.png", deep(colour))
    cv2.imwrite("rgba8.png", np.dstack([colour, alpha]))
    cv2.imwrite("rgba16.png", deep(np.dstack([colour, alpha])))
    cv2.imwrite("grey1.png", grey, [cv2.IMWRITE_PNG_BILEVEL, 1])
    size = "{}x{}".format(*PNG_SIZE)
    raw = ["-f", "rawvideo", "-pix_fmt", "bgra", "-s", size, "-i", "-"]
    for name, pixels in [("grey_alpha8", "ya8"), ("grey_alpha16", "ya16be"), ("palette", "pal8")]:
        options = ["-vf", "split[a][b];[a]palettegen[p];[b][p]paletteuse"] if pixels == "pal8" else []
        ffmpeg(*raw, *options, "-pix_fmt", pixels, "-frames:v", "1", "-update", "1", f"{name}.png", stdin=np.dstack([colour, alpha]).tobytes())
    ffmpeg(*raw, "-pix_fmt", "rgb24", "-pred", "mixed", "-flags", "+ildct", "-frames:v", "1", "-update", "1", "interlaced.png", stdin=np.dstack([colour, alpha]).tobytes())
    for path in pathlib.Path(".").glob("*.png"):
        path.with_suffix(".grey").write_bytes(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).tobytes())


if __name__ == "__main__":
    make_y4m()
    make_avi()
    make_jpeg_without_tables()
    make_png()
