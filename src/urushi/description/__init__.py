"""The description of a material: what it is made of, as frozen, checked data.

Nothing here computes anything. A description is a tree of small classes; each field carries a `Rule`
that reads a value, says in words what is allowed and writes the value back, so that error messages,
the JSON schema, the table of parameters, the files and random test inputs share one source.

    base        Rule and Description: reading, errors, repr, file form
    parameter   numbers, colours, roughness, normals and textures
    phases      phase functions and their registry
    layers      interfaces and media and their registry
    schema      the JSON schema of a material file
    reading     YAML and JSON text into plain data, with line numbers
    writing     plain data into YAML and JSON text
"""
