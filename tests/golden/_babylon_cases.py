def babylon_cases():
    return {}
