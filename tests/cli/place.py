"""place.py IN.obj SCALE UP X,Y,Z OUT.obj: moves the mesh of an OBJ file as --scale, --up, --translate.

UP is y, z or keep. Numbers are computed in double precision and written with all their digits.
"""
import sys

TURNS = {"keep": lambda x, y, z: (x, y, z),
         "y": lambda x, y, z: (x, z, -y),
         "z": lambda x, y, z: (x, -z, y)}


def main(source, scale, up, translation, target):
    scale = float(scale)
    shift = [float(word) for word in translation.split(",")]
    with open(source) as lines, open(target, "w") as out:
        for line in lines:
            words = line.split()
            if words[:1] in (["v"], ["vn"]):
                vector = [float(word) for word in words[1:4]]
                if words[0] == "v":
                    vector = TURNS[up](*(number * scale for number in vector))
                    vector = [a + b for a, b in zip(vector, shift)]
                else:
                    vector = TURNS[up](*vector)
                line = " ".join(words[:1] + [repr(number) for number in vector] + words[4:]) + "\n"
            out.write(line)


main(*sys.argv[1:])
